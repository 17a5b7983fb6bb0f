"""A program of the graph is killed (SIGKILL): it has no time for last orders. What starts it again is up to its launch
file.
"""


class Kill:
    def begin(self, program, time_s):
        program.kill()


def make(severity, rng):
    return Kill()
