"""`./maap doctor`: why does it not fly? Each module looks at one theme and says what it finds: green, yellow or red.

A check is a function of the `situation.Situation` that returns findings. What needs the computer (sockets, files, the
ROS master) is apart from what judges it.
"""
