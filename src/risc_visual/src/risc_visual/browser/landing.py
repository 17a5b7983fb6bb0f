"""Asking several at once, and reporting each answer, or that none came. No ROS."""

import threading


def ask_all(questions, limit_s, tell):
    """Ask all at the same time. questions: dict name -> callable without arguments that returns (done, text).

    tell(name, done, text) is called for every answer, in a thread of its own. What has not answered after `limit_s` [s]
    is reported as failed then, and once more if an answer comes after all. A question that raises has failed: what it
    raises is the text.
    """
    for item in questions.items():
        threading.Thread(target=_ask, args=(*item, limit_s, tell), daemon=True).start()


def _ask(name, question, limit_s, tell):
    late = threading.Timer(limit_s, tell, (name, False, "no answer within %g s" % limit_s))
    late.daemon = True
    late.start()
    try:
        done, text = question()
    except Exception as error:  # whatever it is, it must not look good
        done, text = False, "%s: %s" % (type(error).__name__, error)
    late.cancel()
    late.join()  # if it was late, that is told before the answer
    tell(name, done, text)
