"""The Cortex host is killed, and started again when the fault is over."""


class Restart:
    def begin(self, hosts, time_s):
        hosts["cortex"].stop()

    def end(self, hosts, time_s):
        hosts["cortex"].start()


def make(severity, rng):
    return Restart()
