"""A program of the graph is killed (SIGKILL): it cannot send final commands. Whether it is started again is up to its
launch file.
"""


class Kill:
    def begin(self, program, time_s):
        program.kill()


def make(severity, rng):
    return Kill()
