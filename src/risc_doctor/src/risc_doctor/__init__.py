"""`./maap doctor`: why does it not fly? Each module checks one topic and returns findings: green, yellow or red.

A check is a function of the `situation.Situation` that returns findings. Code that reads the computer (sockets, files,
the ROS master) is separate from code that judges the result.
"""
