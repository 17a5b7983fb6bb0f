"""The Cortex protocol for Python, used by the virtual lab (host side) and the doctor. The node's client is in C++."""
