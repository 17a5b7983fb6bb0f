"""The cameras of the virtual lab: pictures from the physics, as H.264 on the wire."""
