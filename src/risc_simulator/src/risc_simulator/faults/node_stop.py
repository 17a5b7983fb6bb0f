"""A program of the graph hangs (SIGSTOP), and goes on when the fault is over (SIGCONT)."""


class Stop:
    def begin(self, program, time_s):
        program.stop()

    def end(self, program, time_s):
        program.resume()


def make(severity, rng):
    return Stop()
