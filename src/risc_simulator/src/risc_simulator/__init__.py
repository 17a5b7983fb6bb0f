"""The virtual lab: physics, and hosts that speak the wire protocols of mocap and vehicles."""
