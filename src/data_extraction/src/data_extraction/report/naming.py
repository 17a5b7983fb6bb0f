"""Whose a topic is."""


def vehicle_of(topic, levels=1):
    """Vehicle's namespace of a topic: /risc1/safety -> risc1; "vehicle" for the only one, whose topics have none.

    levels: of the topic below the namespace, e.g. 2 for ardrone/navdata.
    """
    parts = topic.strip("/").split("/")
    return parts[0] if len(parts) > levels else "vehicle"
