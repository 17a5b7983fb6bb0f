"""Ask several at once, and report each answer, or that there was none. No ROS."""

import threading


def ask_all(questions, limit_s, tell):
    """Ask all at the same time. questions: dict name -> callable without arguments that returns (done, text).

    tell(name, done, text) is called for every answer, in a thread of its own. A question without an answer after
    `limit_s` [s] is reported as failed, and once more if the answer comes later. One that raises has failed, with the
    exception as its text.
    """
    for item in questions.items():
        threading.Thread(target=_ask, args=(*item, limit_s, tell), daemon=True).start()


def _ask(name, question, limit_s, tell):
    late = threading.Timer(limit_s, tell, (name, False, "no answer within %g s" % limit_s))
    late.daemon = True
    late.start()
    try:
        done, text = question()
    except Exception as error:  # any error must be reported as a failure
        done, text = False, "%s: %s" % (type(error).__name__, error)
    late.cancel()
    late.join()  # a timeout is reported before the late answer
    tell(name, done, text)
