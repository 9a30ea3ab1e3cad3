"""Control: stores operators' changes of settings, and sends them to vehicles, again when a vehicle comes back.

A change is stored before it is sent, so the vehicle gets it later even if the server is killed. Changes of one stream
are sent one after the other. A few threads send settings to vehicles that came back or did not answer.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from lidarcodec.apps.control import asked_by
from lidarcodec.errors import LidarCodecError, SettingsError, TransportError
from lidarcodec.ratecontrol.image_curve import ImageKind
from lidarcodec.settings import StreamSettings
from lidarcodec.transport import Transport
from lidarcodec.transport.keys import StreamKeys
from lidarcodec.untrusted.json import JsonRefusedError
from lidarcodec_server.fleet.answers import Applied, AwayError, RefusedError, State
from lidarcodec_server.fleet.desired import in_step, overlaid, wanted_with
from lidarcodec_server.fleet.fleet import Fleet
from lidarcodec_server.fleet.rivals import Override, Rivals
from lidarcodec_server.fleet.turns import BusyError, Turns
from lidarcodec_server.limits import SparseLog
from lidarcodec_server.store.store import Store
from lidarcodec_server.store.wanted import ChangedError
from lidarcodec_server.told import (
    check_names,
    check_settings_size,
    first_frame,
    images_told,
    known_settings,
    read_answer,
)

logger = logging.getLogger(__name__)

OTHERS = "somebody else"
"""Name in the audit log for changes of a vehicle's settings that this server did not send."""
SERVER = "server"
"""Name in the audit log when this server sent the operators' settings to a vehicle that came back."""
KEEPS = "the server (it keeps what operators set)"
"""Name in the vehicle's terminal when this server sends those settings."""
GET_S = 1.0
AGAIN_S = 2.0
RARELY_S = 60.0
"""First and longest wait before a connected vehicle that did not answer is asked again."""
WORKERS = 4
TRIES = 10
"""Most tries of a change while another server with the same database changes the same stream."""
CLOSE_S = 2.0
"""Longest wait for answers of vehicles when the server stops; the settings are in the store anyway."""
MAX_REASON, MAX_FIELD = 500, 100


class Control:
    """Changes settings of streams; see the module. Thread-safe; methods block for seconds at most."""

    def __init__(self, fleet: Fleet, store: Store, transport: Callable[[], Transport], answer_s: float = 3.0) -> None:
        """transport: gives the network session, or raises TransportError while there is none"""
        self._fleet, self._store, self._transport, self._answer_s = fleet, store, transport, answer_s
        self._turns = Turns()
        self._due: dict[StreamKeys, float] = {}
        self._wake = threading.Condition()
        self._stopped = False
        self._refusals: dict[StreamKeys, str] = {}
        self._resets: set[StreamKeys] = set()
        """Vehicles that were away when the settings of operators were deleted."""
        self._rivals = Rivals()
        self._tries: dict[StreamKeys, int] = {}
        self._warnings = SparseLog(logger)
        self._threads = [
            threading.Thread(target=self._look_after, name=f"lidarcodec server control {number}", daemon=True)
            for number in range(WORKERS)
        ]

    def start(self) -> None:
        """Start the threads that send settings to vehicles."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop the threads. A second call does nothing."""
        with self._wake:
            self._stopped = True
            self._wake.notify_all()
        end = time.monotonic() + CLOSE_S
        for thread in self._threads:
            if thread.is_alive():
                thread.join(max(0.0, end - time.monotonic()))

    # --- requests of operators --------------------------------------------------------------------------------------

    def state(self, keys: StreamKeys, *, ask: bool = True) -> State:
        """The settings in force, and those that operators want.

        ask: ask the vehicle, if it is connected; otherwise use the settings that it reported last
        """
        stream = self._fleet.get(keys)
        last = applied = None if stream is None else stream.settings
        if stream is not None:
            applied = ((self._ask_settings(keys) if ask else None) or last) if stream.alive else None
        wanted = self._store.desired(keys)
        desired, refused = overlaid(wanted, applied or last), self._refusals.get(keys)
        return State(applied, desired, wanted, refused=refused, images=self._images(keys))

    def _images(self, keys: StreamKeys) -> ImageKind | None:
        stream = self._fleet.get(keys)
        return None if stream is None else images_told(stream.status)

    def change(
        self, keys: StreamKeys, changes: dict[str, Any], who: str, entered: Callable[[], object] = lambda: None
    ) -> State:
        """Change settings, all of them or none; `applied` is None when the vehicle will get them later.

        entered: called when the change is in the audit log; changes refused before that are not entered here

        Raises SettingsError or UnknownNameError when they are not allowed, RefusedError when the vehicle refuses them,
        StoreError, BusyError. Then nothing was changed.
        """
        if not changes:
            raise SettingsError("no setting is given: give at least one")
        check_settings_size(changes)
        check_names(changes.get("codec_settings"))
        with self._turns.hold(keys):
            stream = self._fleet.get(keys)
            alive = stream is not None and stream.alive
            current = None if stream is None else stream.settings
            if alive:
                current = self._ask_settings(keys) or current
            entry, before, wanted = self._begin(keys, changes, who, current)
            entered()
            try:
                if alive and keys in self._resets:  # it is back, and its settings were deleted while it was away
                    self._reset(keys)
                applied = self._send(keys, wanted, who) if alive else None
            except RefusedError as error:
                self._store.finish(entry, "refused", reason=str(error), restore=(keys, before, wanted))
                raise
            if applied is not None:
                applied, wanted = self._send_newer(keys, applied, wanted, who)
            self._refusals.pop(keys, None)
            self._rivals.forget(keys)
            self._finish(keys, entry, applied)
            if applied is None:
                self.look_after(keys, AGAIN_S)
                return State(None, overlaid(wanted, current), wanted)
            self._rivals.sent(keys, wanted)
            self._fleet.answered(keys, applied.settings)
            desired = overlaid(wanted, applied.settings)
            return State(applied.settings, desired, wanted, applied.first_frame, images=self._images(keys))

    def _begin(
        self, keys: StreamKeys, changes: dict[str, Any], who: str, current: StreamSettings | None
    ) -> tuple[int, dict[str, Any], dict[str, Any]]:
        """Store a change. Returns its entry in the audit log, and what was wanted before, and is now."""
        for _ in range(TRIES):
            before = self._store.desired(keys)
            wanted = wanted_with(before, changes, current)
            asked = {field: wanted[field] for field in changes}
            old = None if current is None else current.model_dump()
            with suppress(ChangedError):
                return self._store.begin(keys, who, "settings", asked, old, wanted, before), before, wanted
        raise BusyError(f"another server changes the settings of {keys.vehicle}/{keys.sensor}: try again later")

    def _send_newer(
        self, keys: StreamKeys, applied: Applied, wanted: dict[str, Any], who: str
    ) -> tuple[Applied, dict[str, Any]]:
        """Send what another server with the same database has stored meanwhile. Returns what is applied and wanted."""
        try:
            for _ in range(TRIES):
                newer = self._store.desired(keys)
                sent = None if not newer or newer == wanted else self._send(keys, newer, who)
                if sent is None:
                    break
                applied, wanted = sent, newer
        except LidarCodecError as error:  # that server sends it, or tells its operator why not
            self._warnings.warning("%s: what another server has stored was not sent: %s", keys.prefix, error)
        return applied, wanted

    def forget(self, keys: StreamKeys, who: str, entered: Callable[[], object] = lambda: None) -> State:
        """Delete the settings of operators, and have the vehicle return to those of its command line: now, or as soon
        as it is there. `first_frame` is None when that comes later, or if operators had set nothing.

        entered: called when this is in the audit log; if there were no settings of operators, nothing is entered
        """
        applied = None
        with self._turns.hold(keys):
            before = self._store.desired(keys)
            if before:
                entry = self._store.begin(keys, who, "forget", {}, before, {})
                entered()
                self._refusals.pop(keys, None)
                self._rivals.forget(keys)
                applied = self._reset(keys, who)
                self._finish(keys, entry, applied)
                if applied is None:
                    self.look_after(keys, AGAIN_S)
        return self.state(keys)._replace(first_frame=None if applied is None else applied.first_frame)

    def _reset(self, keys: StreamKeys, who: str = KEEPS) -> Applied | None:
        """Have a vehicle return to the settings of its command line; None if it is away, or does not answer."""
        self._resets.add(keys)
        stream = self._fleet.get(keys)
        if stream is None or not stream.alive:
            return None
        try:
            applied = self._result(keys, self._ask(keys.control_reset, asked_by(who), self._answer_s))
        except RefusedError as error:  # its own settings cannot be used now, for example without a process for a codec
            self._warnings.warning("%s cannot return to its own settings yet: %s", keys.prefix, error)
            return None
        if applied is not None:
            self._resets.discard(keys)
            self._fleet.answered(keys, applied.settings)
        return applied

    def key_frame(self, keys: StreamKeys) -> dict[str, Any]:
        """Ask for a key frame; returns the vehicle's answer.

        Raises AwayError.
        """
        stream = self._fleet.get(keys)
        data = self._ask(keys.control_keyframe, {}, self._answer_s) if stream is not None and stream.alive else None
        first = None if data is None else first_frame(data)
        if data is None or first is None:
            raise AwayError(f"{keys.vehicle}/{keys.sensor} is not connected, or does not answer")
        return {"first_frame": first, "merged": data.get("merged") is True}

    # --- vehicles that come back ------------------------------------------------------------------------------------

    def look_after(self, keys: StreamKeys, in_s: float = 0.0) -> None:
        """Check soon whether a vehicle has the wanted settings, and send them if not."""
        if not in_s:
            self._tries.pop(keys, None)
            self._rivals.returned(keys)
        self._look_soon(keys, in_s)

    def told(self, keys: StreamKeys) -> None:
        """A status of a vehicle arrived: check whether another program changed its settings."""
        stream = self._fleet.get(keys)
        if stream is not None and stream.settings is not None and self._rivals.told(keys, stream.settings):
            self._look_soon(keys)

    def _look_soon(self, keys: StreamKeys, in_s: float = 0.0) -> None:
        with self._wake:
            due = time.monotonic() + in_s
            self._due[keys] = min(due, self._due.get(keys, due))
            self._wake.notify()

    def _look_after(self) -> None:
        while (keys := self._next()) is not None:
            try:
                settled = self._settle(keys)
            except LidarCodecError as error:
                self._warnings.warning("%s: settings could not be sent and will be tried again: %s", keys.prefix, error)
                settled = False
            except Exception:
                logger.exception("%s: settings could not be sent", keys.prefix)
                settled = True
            if settled:
                self._tries.pop(keys, None)
            else:
                tries = self._tries[keys] = self._tries.get(keys, 0) + 1
                self.look_after(keys, min(AGAIN_S * 2 ** min(tries - 1, 10), RARELY_S))

    def _next(self) -> StreamKeys | None:
        with self._wake:
            while not self._stopped:
                now = time.monotonic()
                keys = min(self._due, key=lambda one: self._due[one], default=None)
                if keys is not None and self._due[keys] <= now:
                    del self._due[keys]
                    return keys
                self._wake.wait(RARELY_S if keys is None else self._due[keys] - now)
            return None

    def _settle(self, keys: StreamKeys) -> bool:
        """Send settings to a stream if needed. Returns whether nothing is left to do."""
        with self._turns.hold(keys):
            stream = self._fleet.get(keys)
            wanted = self._store.desired(keys)
            changed = self._rivals.to_tell(keys, wanted)
            if stream is None or not stream.alive:
                return True
            if keys in self._resets and self._reset(keys) is None:
                return False
            if not wanted:
                return True
            if changed is not None or self._rivals.leave_it(keys):
                self._leave_to_others(keys, wanted, changed)
                return True
            current = self._ask_settings(keys)
            if current is None:
                return False
            if in_step(wanted, current):
                self._refusals.pop(keys, None)
                self._rivals.sent(keys, wanted)
                return True
            old = current.model_dump()
            try:
                applied = self._send(keys, wanted)
            except RefusedError as error:
                logger.warning("%s refuses the settings of operators: %s", keys.prefix, error)
                self._refusals[keys] = str(error)
                self._store.note(keys, SERVER, "settings", wanted, old, result="refused", reason=str(error))
                return True
            if applied is None:  # no audit entry: a vehicle that never answers would fill the log
                return False
            applied, wanted = self._send_newer(keys, applied, wanted, KEEPS)
            self._refusals.pop(keys, None)
            new = applied.settings.model_dump()
            outcome = {"result": "applied", "new": new, "first_frame": applied.first_frame}
            self._store.note(keys, SERVER, "settings", wanted, old, **outcome)
            self._fleet.answered(keys, applied.settings)  # only now: clients see only what is in the audit log
            self._rivals.sent(keys, wanted)
            return True

    def _leave_to_others(self, keys: StreamKeys, wanted: dict[str, Any], changed: Override | None) -> None:
        """Report that another program changes a vehicle's settings, and send nothing: otherwise two servers would
        overwrite each other without end.
        """
        why = "another server or program also changes the settings of this vehicle"
        if changed is not None:
            why += f": {changed.text}"
        if self._rivals.leave_it(keys):
            why += "; nothing more is sent to it until its settings are changed here"
        try:
            if changed is not None and changed.new:
                logger.warning("%s: %s", keys.prefix, why)
                self._store.note(keys, OTHERS, "settings", wanted, result="overridden", reason=why)
        finally:
            self._refusals[keys] = why  # only now: clients see only what is in the audit log

    def _finish(self, keys: StreamKeys, entry: int, applied: Applied | None) -> None:
        """Enter the result of a change in the audit log. If the store fails, the vehicle keeps the change."""
        try:
            if applied is None:
                self._store.finish(entry, "stored")
            else:
                self._store.finish(entry, "applied", applied.settings.model_dump(), first_frame=applied.first_frame)
        except LidarCodecError as error:
            logger.warning(
                "%s: the result of entry %d could not be written to the audit log: %s", keys.prefix, entry, error
            )

    # --- queries to vehicles ----------------------------------------------------------------------------------------

    def _send(self, keys: StreamKeys, wanted: dict[str, Any], who: str = KEEPS) -> Applied | None:
        """The vehicle's answer to a change, None if none came.

        Raises RefusedError.
        """
        return self._result(keys, self._ask(keys.control_set, wanted | asked_by(who), self._answer_s))

    def _result(self, keys: StreamKeys, answer: dict[str, Any] | None) -> Applied | None:
        """What a vehicle answered to a change, None if it did not.

        Raises RefusedError.
        """
        if answer is None:
            return None
        if "retry_s" in answer:
            reason = _reason_text(answer.get("error"))
            self._warnings.warning("no more changes are sent to %s for now: %s", keys.prefix, reason)
            return None
        if "error" in answer:
            field = answer.get("field")
            raise RefusedError(_reason_text(answer["error"]), field[:MAX_FIELD] if isinstance(field, str) else None)
        settings = known_settings(answer.get("applied"))
        if settings is None:
            logger.warning("%s: the answer to a change has no settings", keys.prefix)
            return None
        return Applied(settings, first_frame(answer))

    def _ask_settings(self, keys: StreamKeys) -> StreamSettings | None:
        answer = self._ask(keys.control_get, {}, GET_S)
        settings = known_settings((answer or {}).get("settings"))
        if settings is not None:
            self._fleet.answered(keys, settings)
        return settings

    def _ask(self, key: str, query: dict[str, Any], timeout_s: float) -> dict[str, Any] | None:
        try:
            data = self._transport().ask(key, json.dumps(query).encode(), timeout_s)
            return None if data is None else read_answer(data)
        except TransportError:
            return None
        except JsonRefusedError as error:
            self._warnings.warning("cannot read the answer to %s: %s", key, error)
            return None


def _reason_text(reason: object) -> str:
    """The reason that a vehicle gave, shortened for the log."""
    return reason[:MAX_REASON] if isinstance(reason, str) and reason else "the vehicle gave no reason"
