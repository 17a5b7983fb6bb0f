"""Wire codec of the AR.Drone 2.0: bytes to values and back, for both ends of the link.

at      commands, client to aircraft (UDP 5556)
navdata telemetry, aircraft to client (UDP 5554)
config  configuration keys, their text on TCP 5559, multi-configuration ids
video   framing of the pictures, aircraft to client (TCP 5555)

Everything is little-endian; floats are IEEE-754 single precision.  No sockets, no clock, no ROS: the driver and the
emulator of the aircraft both use these modules.
"""

FTP_PORT = 5551  # TCP, version.txt; not used by the driver
NAVDATA_PORT = 5554  # UDP, answers to the source address of the last wake-up datagram
VIDEO_PORT = 5555  # TCP, PaVE + H.264
AT_PORT = 5556  # UDP
CONTROL_PORT = 5559  # TCP, configuration text

DEFAULT_ADDRESS = "192.168.1.1"  # of an aircraft that acts as an access point
