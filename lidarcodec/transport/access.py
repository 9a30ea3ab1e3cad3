"""Permissions on the keys of a stream, as rules for Zenoh's access control.

A vehicle has its own keys and no others. A viewer sees every stream, may ask for a key frame and for the settings, and
reports under its own name only. An operator is a viewer who may also change settings, say where a sensor is (`pose`),
fetch and mark what a vehicle kept, play recordings as vehicles named `playback-...`, and serve maps. Everybody may ask
for maps. What is not allowed is denied.

Two properties of that access control determine these rules. It works on links, so the side that accepts connections
has the rules: routers, and vehicles that listen themselves. Clients of such vehicles have rules too (`vehicles_only`),
otherwise one vehicle could send under the name of another. And a rule must cover the whole key expression: a client
that is allowed `a/frame` and subscribes to `a/*` gets nothing, without an error. `flows` are those of the side that has
the rules: `ingress` is what the other side sends.

>>> people = People(vehicles=("car-7",), viewers=("anna",))
>>> [policy["subjects"] for policy in access_control(people, "certificate")["policies"]]
[['routers'], ['vehicle car-7'], ['viewers', 'operators'], ['operators'], ['operators'], ['receiver anna']]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from lidarcodec.transport.keys import PREFIX

ROUTER = "router"
"""Name of all routers of a deployment, in their certificates or as a user."""
PLAYBACKS = "playback-"
"""Prefix of vehicle names for recordings that a server plays. A server is an operator; other names cannot have it."""
Auth = Literal["certificate", "password", "none"]
ANY = f"{PREFIX}/*/*"
MAPS = f"{PREFIX}/@maps/**"
"""Keys of maps. In Zenoh `*` and `**` cover no part of a key that begins with @, so rules name it."""
EVERY_KEY = [f"{PREFIX}/**", MAPS]
WATCHING = ["liveliness_query", "declare_liveliness_subscriber"]
PUTTING = ["put", "delete"]
EVERYTHING = [*PUTTING, "declare_subscriber", "query", "reply", "declare_queryable", "liveliness_token", *WATCHING]


@dataclass(frozen=True)
class People:
    """Names by role. No name has two roles."""

    vehicles: tuple[str, ...] = ()
    viewers: tuple[str, ...] = ()
    operators: tuple[str, ...] = ()


class _Rules:
    """Collects rules, subjects and policies."""

    def __init__(self, subject_field: str) -> None:
        self._field = subject_field
        self.rules: list[dict[str, Any]] = []
        self.subjects: list[dict[str, Any]] = []
        self.policies: list[dict[str, Any]] = []

    def subject(self, name: str, people: list[str]) -> None:
        """Add a subject. Zenoh applies a subject without names to everyone, so an empty one gets an impossible name."""
        self.subjects.append({"id": name, self._field: people or ["/nobody/"]})

    def allow(self, subjects: list[str], *rules: tuple[list[str], list[str], list[str]]) -> None:
        """Allow rules, each (messages, flows, keys), for subjects."""
        names: list[str] = []
        for messages, flows, keys in rules:
            names.append(f"{', '.join(subjects)}: {len(self.rules) + 1}")
            rule = {"id": names[-1], "permission": "allow", "messages": messages, "flows": flows, "key_exprs": keys}
            self.rules.append(rule)
        self.policies.append({"rules": names, "subjects": subjects})

    def whole(self) -> dict[str, Any]:
        """The configuration for Zenoh; everything else is denied."""
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": self.rules,
            "subjects": self.subjects,
            "policies": self.policies,
        }


def access_control(people: People, auth: Auth) -> dict[str, Any]:
    """Zenoh's `access_control` for the side that accepts connections from these people.

    auth: `certificate`: they are known by the common name of their certificate; `password`: by their user name;
          `none`: they cannot be identified, so everything is allowed
    """
    if auth == "none":
        return {"enabled": False}
    made = _Rules("cert_common_names" if auth == "certificate" else "usernames")
    made.subject("routers", [ROUTER])
    made.allow(["routers"], (EVERYTHING, ["ingress", "egress"], EVERY_KEY))
    for name in people.vehicles:
        made.subject(f"vehicle {name}", [name])
        made.allow([f"vehicle {name}"], *_vehicle(f"{PREFIX}/{name}/*"), *_asking_for([MAPS]))
    made.subject("viewers", list(people.viewers))
    made.subject("operators", list(people.operators))
    made.allow(["viewers", "operators"], *_looking(), *_asking_for([MAPS]))
    serving = (["declare_queryable", "reply"], ["ingress"], [MAPS]), (["query"], ["egress"], [MAPS])
    made.allow(["operators"], *_asking(["control/set", "control/reset", "past", "past/mark"]), *serving)
    made.allow(["operators"], *_vehicle(f"{PREFIX}/{PLAYBACKS}$*/*"))
    for name in people.viewers + people.operators:
        reports = ("arrived", "refined", "report", *(["pose"] if name in people.operators else []))
        made.subject(f"receiver {name}", [name])
        made.allow([f"receiver {name}"], *_reporting(name, reports))
    return made.whole()


def vehicles_only(vehicles: tuple[str, ...], auth: Auth) -> dict[str, Any]:
    """Zenoh's `access_control` for the side that connects to vehicles themselves, with no router between.

    Each vehicle is identified by the common name of its certificate, and accepted under its own name only. The rules of
    a vehicle cover its own links, not those of other vehicles.
    """
    if auth == "none":
        return {"enabled": False}
    made = _Rules("cert_common_names")
    made.subject("all vehicles", list(vehicles))
    made.allow(["all vehicles"], (EVERYTHING, ["egress"], EVERY_KEY), (["query"], ["ingress"], [MAPS]))
    for name in vehicles:
        made.subject(f"vehicle {name}", [name])
        made.allow([f"vehicle {name}"], (EVERYTHING, ["ingress"], [f"{PREFIX}/{name}/**"]))
    return made.whole()


def _under(prefix: str, *ends: str) -> list[str]:
    return [f"{prefix}/{end}" for end in ends]


def _vehicle(own: str) -> tuple[tuple[list[str], list[str], list[str]], ...]:
    """What a vehicle may do under its own keys."""
    controls = _under(own, "control/get", "control/set", "control/reset", "control/keyframe", "past", "past/mark")
    reports = _under(own, "arrived/*", "refined/*", "report/*", "pose/*", "odometry")
    return (
        (PUTTING, ["ingress"], _under(own, "frame", "refine/*", "status", "odometry")),
        (["declare_queryable", "reply"], ["ingress"], controls),
        (["liveliness_token"], ["ingress"], _under(own, "alive")),
        (["declare_subscriber"], ["ingress"], reports),
        (WATCHING, ["ingress"], _under(own, "arrived/*")),
        (PUTTING, ["egress"], reports),
        (["query"], ["egress"], controls),
        (["liveliness_token"], ["egress"], _under(own, "arrived/*")),
        # For all streams: without declarations of all subscribers the vehicle would send nothing.
        (["declare_subscriber"], ["egress"], _under(ANY, "frame", "refine/*", "status", "odometry")),
    )


def _looking() -> tuple[tuple[list[str], list[str], list[str]], ...]:
    """Rules of every receiver, for all streams."""
    return (
        (["declare_subscriber"], ["ingress"], _under(ANY, "frame", "refine/*", "status", "odometry", "pose/*")),
        (PUTTING, ["egress"], _under(ANY, "frame", "refine/*", "status", "odometry", "pose/*")),
        (WATCHING, ["ingress"], _under(ANY, "alive")),
        (["liveliness_token"], ["egress"], _under(ANY, "alive")),
        (["declare_subscriber"], ["egress"], _under(ANY, "arrived/*", "refined/*", "report/*", "pose/*")),
        *_asking(["control/get", "control/keyframe"]),
    )


def _asking(controls: list[str]) -> tuple[tuple[list[str], list[str], list[str]], ...]:
    return _asking_for(_under(ANY, *controls))


def _asking_for(keys: list[str]) -> tuple[tuple[list[str], list[str], list[str]], ...]:
    """Rules of those who ask others on these keys."""
    return (["query"], ["ingress"], keys), (["declare_queryable", "reply"], ["egress"], keys)


def _reporting(name: str, reports: tuple[str, ...]) -> tuple[tuple[list[str], list[str], list[str]], ...]:
    """Rules for the reports of a receiver, under its own name."""
    return (
        (PUTTING, ["ingress"], _under(ANY, *(f"{key}/{name}" for key in reports))),
        (["liveliness_token"], ["ingress"], _under(ANY, f"arrived/{name}")),
    )
