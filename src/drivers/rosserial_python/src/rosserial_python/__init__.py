"""Topics of a microcontroller in the graph. `protocol`, `link` are pure; `ports` opens lines; `ros` connects to ROS."""
