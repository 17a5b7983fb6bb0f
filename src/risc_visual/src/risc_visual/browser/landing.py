"""Asking several at once, and telling what each answers, or that it does not. No ROS."""

import threading
import time


def ask_all(questions, limit_s, tell):
    """Ask all at the same time. questions: dict name -> callable without arguments that returns (done, text).

    tell(name, done, text) is called for every answer, one at a time. Who has not answered after `limit_s` [s] is told
    as failed then, and once more if an answer comes after all. A question that raises has failed: what it raises is the
    text. Returns when everybody has answered or the time is over.
    """
    lock = threading.Lock()
    answered = set()

    def ask(name, question):
        try:
            done, text = question()
        except Exception as error:  # whatever it is, the others' answers count, and this one's must not look good
            done, text = False, "%s: %s" % (type(error).__name__, error)
        with lock:
            answered.add(name)
            tell(name, done, text)

    threads = [threading.Thread(target=ask, args=item, daemon=True) for item in questions.items()]
    for thread in threads:
        thread.start()
    end_s = time.monotonic() + limit_s
    for thread in threads:
        thread.join(max(0.0, end_s - time.monotonic()))
    with lock:
        for name in questions:
            if name not in answered:
                tell(name, False, "no answer within %g s" % limit_s)
