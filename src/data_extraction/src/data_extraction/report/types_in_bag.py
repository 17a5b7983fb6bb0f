"""Which type each vehicle of a bag is: from its fleet, else from its driver's topics, else from the lab's names."""

from data_extraction.report.recorded_topics import fits
from risc_control.vehicles import REGISTRY
from risc_lab.lab import load_vehicle_type

_WITH_NAMES = ("/node_status", "/vehicle_status")  # topics whose messages name the vehicle of their namespace


def vehicle_types(bag, fleet=None):
    """{template: VehicleType} of the vehicles whose type is known. bag: an open Bag; fleet: Fleet or None."""
    if fleet:
        return {vehicle.template: vehicle.vehicle_type for vehicle in fleet.vehicles}
    found = {template: name for name in REGISTRY.names() for template in load_vehicle_type(name).laboratory.values()}
    by_namespace = _types_by_namespace(bag.topics)
    found.update((template, by_namespace[namespace]) for namespace, template in _templates(bag, by_namespace))
    return {template: load_vehicle_type(name) for template, name in found.items()}


def _types_by_namespace(topics):
    """{"/risc1": name of the type} of the namespaces with topics of a type's driver, e.g. /risc1/ardrone/navdata."""
    found = {}
    for name in REGISTRY.names():
        if load_vehicle_type(name).driver not in ("", name):
            continue  # its topics are those of another type
        for driver in {topic.partition("/")[0] for topic in REGISTRY.module(name).Adapter.EVENT_TOPICS}:
            parts = [(topic + "/").partition("/%s/" % driver) for topic in topics]
            found.update((namespace, name) for namespace, driver_found, _ in parts if driver_found)
    return found


def _templates(bag, namespaces):
    """(namespace, template) of each of these namespaces, from the first message that names its vehicle."""
    topics = {namespace + end: namespace for namespace in namespaces for end in _WITH_NAMES}
    topics = {topic: topics[topic] for topic in topics if bag.topics.get(topic) and fits(topic, bag.types[topic])}
    waiting = set(topics.values())
    for topic, _, message in bag.messages(topics):
        if not waiting:
            return
        if topics[topic] in waiting and message.name:
            waiting.remove(topics[topic])
            yield topics[topic], message.name
