"""The Cortex protocol for Python: what the virtual lab answers and the doctor asks with. The client is in C++."""
