"""The IRIS+: a Pixhawk with ArduCopter."""
