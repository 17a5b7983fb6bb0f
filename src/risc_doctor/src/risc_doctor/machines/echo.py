"""One end of a conversation that shows whether topics flow: `python -m risc_doctor.machines.echo --help`.

Runs on two computers at once. Each says how far it has come: 0 nothing heard, 1 the other one heard.
Prints what became of it as one line of JSON.
"""

import argparse
import json
import os
import shutil
import signal
import socket
import sys
import tempfile
import threading
from urllib.parse import urlsplit

_PERIOD_S = 0.05
_REACH_S = 2.0


def trouble_with(uri):
    """Why nobody answers at http://HOST:PORT/ as seen from this computer; "" when somebody does."""
    parts = urlsplit(uri)
    try:
        socket.create_connection((parts.hostname, parts.port), _REACH_S).close()
    except socket.gaierror:
        return "the name %s cannot be resolved" % parts.hostname
    except TimeoutError:
        return "no answer from %s" % parts.netloc
    except OSError as error:
        return "%s: %s" % (parts.netloc, error.strerror or error)
    return ""


def converse(say, hear, limit_s):
    """Publish on one topic, listen on the other. Returns the outcome as a dictionary."""
    import rospy  # late: it reads ROS_LOG_DIR when it is imported
    from std_msgs.msg import UInt8

    heard, answered, stop = threading.Event(), threading.Event(), threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    rospy.init_node("echo", anonymous=True, disable_signals=True)

    def listen(message):
        heard.set()
        if message.data:
            answered.set()
            stop.set()

    publisher = rospy.Publisher(say, UInt8, queue_size=1)
    rospy.Subscriber(hear, UInt8, listen, tcp_nodelay=True)
    for _ in range(int(limit_s / _PERIOD_S)):
        publisher.publish(UInt8(1 if heard.is_set() else 0))
        if stop.wait(_PERIOD_S):
            break
    publisher.publish(UInt8(1 if heard.is_set() else 0))
    outcome = {"heard": heard.is_set(), "answered": answered.is_set(), "uri": rospy.get_node_uri()}
    if not heard.is_set():
        outcome.update(_the_other(rospy, hear))
    return outcome


def _the_other(rospy, topic):
    """Where the other one says that it is, and why we cannot reach it there."""
    master = rospy.get_master()
    _, _, (publishers, _, _) = master.getSystemState()
    nodes = [node for name, names in publishers if name == topic for node in names]
    if not nodes:
        return {"other": "", "trouble": "it never came to the master"}
    uri = master.lookupNode(nodes[0])[2]
    return {"other": uri, "trouble": trouble_with(uri)}


def main(argv=None):
    """Hold the conversation."""
    parser = argparse.ArgumentParser(prog="echo", description="One end of a conversation between two computers.")
    parser.add_argument("say", help="topic to publish on")
    parser.add_argument("hear", help="topic to listen on")
    parser.add_argument("limit", type=float, help="[s] after which it ends, whatever was heard")
    args = parser.parse_args(argv)
    outcome = {"master_uri": os.environ["ROS_MASTER_URI"], "host": socket.gethostname()}
    outcome["master_trouble"] = trouble_with(outcome["master_uri"])
    if not outcome["master_trouble"]:
        os.environ["ROS_LOG_DIR"] = folder = tempfile.mkdtemp(prefix="echo")
        try:
            outcome.update(converse(args.say, args.hear, args.limit))
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    print(json.dumps(outcome))
    sys.stdout.flush()
    os._exit(0)  # rospy's threads wait for computers that cannot be reached


if __name__ == "__main__":
    main()
