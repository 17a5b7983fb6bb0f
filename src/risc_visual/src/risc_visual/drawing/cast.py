"""Common parts of drawing: numbers of names, validity of messages, marks of references, the title. Needs no ROS."""

import math

REST_M_S = 0.01  # a reference slower than this counts as standing still


class Index(dict):
    """A number for every name, fixed while the program runs; so each name keeps its id and colour."""

    def __init__(self, names=()):
        super().__init__({name: number for number, name in enumerate(dict.fromkeys(names))})

    def __missing__(self, name):
        return self.setdefault(name, len(self))


def is_news(said_s, now_s, lifetime_s):
    """Whether a message of the time said_s is still valid. ROS times [s], by which rviz lets markers expire: so a bag
    may be played slowly. A time far ahead of now belongs to a bag that was restarted.
    """
    return abs(now_s - said_s) < lifetime_s


def reference_marks(references_m, speeds_m_s, positions_m, vehicles, away_m):
    """Which references deserve a mark of their own: those that stand still, and those their vehicle is not at.

    references_m, positions_m: dicts name -> position (3,) [m] of references and of the vehicles that are seen;
    speeds_m_s: dict name -> speed of the reference; vehicles: names of all vehicles. Returns a list of (name, away):
    away when the vehicle is farther than away_m, or not seen.
    """
    away = {
        name: name in vehicles  # the original release puts a title there, which is no vehicle
        and (name not in positions_m or math.dist(positions_m[name], reference_m) > away_m)
        for name, reference_m in references_m.items()
    }
    return [(name, is_away) for name, is_away in away.items() if is_away or speeds_m_s[name] < REST_M_S]


def title_text(title, phases):
    """Text over the arena: the title, then what the vehicles do, in one word if they all do the same.

    phases: dict name -> phase.
    """
    said = ["%s: %s" % item for item in phases.items()]
    if len(phases) > 1 and len(set(phases.values())) == 1:
        said = [*phases.values()][:1]
    return "\n".join(filter(None, [title, *said]))
