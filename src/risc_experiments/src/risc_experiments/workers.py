"""Runs one function on many items in parallel processes, with the results in order, as from a loop.

Processes are forked by a server that has one thread and has imported what they need. A fork of the caller would be
quicker by a second, but may inherit locks that threads of the caller hold (OpenBLAS, rospy, tests) and keeps the pipes
of the other workers open, so that they outlive a caller that is killed.
"""

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import traceback
from multiprocessing import resource_tracker

_PATIENCE_S = 10.0
AHEAD = 4  # results per worker that may wait for an earlier one: limits the memory


def in_order(function, items, workers=None, on_progress=None):
    """Yields function(item) for each item. function: defined in a module; it, items and results are pickled.

    Workers import the caller's main program: one that is a script calls this below `if __name__ == "__main__":`.
    workers: processes; None: as many as this process may use cores; with one, all is done in this process.
    on_progress: called with the number of finished items, whenever one finishes.
    Raises what the function raises, when it is its item's turn; ValueError for no workers; ChildProcessError when a
    worker dies. However it ends (closed, Ctrl-C, an error), no worker is left.
    """
    items = list(items)
    if workers is None:
        workers = len(os.sched_getaffinity(0))
    if workers < 1:
        raise ValueError("there must be at least one worker, got %d" % workers)
    on_progress = on_progress or (lambda over: None)
    workers = min(workers, len(items))
    return _together(function, items, workers, on_progress) if workers > 1 else _alone(function, items, on_progress)


def _alone(function, items, on_progress):
    for over, item in enumerate(items, 1):
        result = function(item)
        on_progress(over)
        yield result


def _together(function, items, count, on_progress):
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([function.__module__])
    workers, idle, done = [], [], {}  # {index of an item: how it ended}
    given = 0
    try:
        with _interrupt_later():
            workers.extend(_Worker(context, function) for _ in range(count))
        idle += workers
        for turn in range(len(items)):
            while True:
                while idle and given < min(len(items), turn + AHEAD * count):
                    idle.pop().give(given, items[given])
                    given += 1
                if turn in done:
                    break
                for worker in multiprocessing.connection.wait([worker for worker in workers if worker not in idle]):
                    done[worker.index] = worker.outcome()
                    idle.append(worker)
                    on_progress(turn + len(done))
            result, error = done.pop(turn)
            if error is not None:
                raise error
            yield result
    finally:
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.end()


class _Worker:
    """A process that does one item after the other."""

    def __init__(self, context, function):
        self._connection, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(function, theirs), daemon=True)
        self.process.start()
        theirs.close()
        self.index = self._item = None

    def fileno(self):
        """File descriptor that becomes readable when there is an outcome, or the worker has died."""
        return self._connection.fileno()

    def give(self, index, item):
        """Start an item."""
        self.index, self._item = index, item
        with contextlib.suppress(BrokenPipeError):  # it is dead: outcome() says so
            self._connection.send(item)

    def end(self):
        """Wait until it has ended. If terminated, it releases resources such as semaphores; if killed, it cannot."""
        self.process.join(_PATIENCE_S)
        self.process.kill()
        self.process.join()

    def outcome(self):
        """(result, error): one of them None. Raises ChildProcessError when it has died."""
        try:
            return self._connection.recv()
        except (EOFError, ConnectionResetError):
            self.process.join()
            why = "exit code %d" % self.process.exitcode
            if self.process.exitcode < 0:
                why = "killed by signal %d; is there enough memory?" % -self.process.exitcode
            raise ChildProcessError("a worker has died (%s) at %r" % (why, self._item)) from None


def _work(function, connection):
    """Main loop of a worker, until its caller ends it or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole terminal; the caller ends the workers
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # in the middle of an item, too
    # sys.path is that of the caller, where imported packages of the workspace have put their sources first. Only the
    # built packages, which PYTHONPATH names, have the messages.
    sys.path[:] = dict.fromkeys([*filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep)), *sys.path])
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            item = connection.recv()
            try:
                outcome = function(item), None
            except Exception as error:
                error.add_note("in a worker:\n" + traceback.format_exc())
                outcome = None, error
            connection.send(outcome)


@contextlib.contextmanager
def _interrupt_later():
    """Defer Ctrl-C until the end of the block; processes that start in it never see one."""
    resource_tracker.ensure_running()  # started by the first process, it would unblock SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
