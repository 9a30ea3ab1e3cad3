"""What goes on learning while a stream is coded: a network of `riddle`, trained on returns of frames just coded.

The encoder leaves samples of each frame, and asks before each frame whether there are better weights. Where a core is
spare, `learn` is called, from any thread. Of every eighth frame no sample is learned from: on those
it is measured what weights would save, and they are offered only when that is more than they cost to send. All is
drawn from the frames and counted in steps, so the same frames and the same calls give the same weights.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from lidarcodec.entropy import NativeNets, NetTrainer, ReturnSamples, TrainSettings
from lidarcodec.errors import SectionError, SettingsError
from lidarcodec.frame import Frame
from lidarcodec.network.networks import Net, Weights, quantised
from lidarcodec.network.shelf import native_nets
from lidarcodec.network.update import Update, update_of

TRAINING: Final = TrainSettings(
    rate=1e-3, mean=0.9999, beside=0.6, batch=512, room=1 << 22, turns=80, held_room=1 << 15
)
SAMPLES: Final = 12000
"""Of each frame, at least."""
DRAWS: Final = 4
"""How often a sample is learned from: where more steps are taken, more samples are. More often, they are learned by
heart."""
BESIDE_ANEW: Final = 0.3
"""How much of what contexts said still goes for another network: they soon learn again what is left of it. Measured
on drive 0005 (research/notes/weighing-networks-and-contexts.md): 1.0 would find other weights worse than they turn out
to be."""
HELD_EVERY: Final = 8
"""Of so many frames one is measured on instead."""
HELD_SAMPLES: Final = 3000
"""Of each of those: few of many frames tell more of what comes than many of the last ones."""
DOUBT: Final = 0.03
"""Bits a return that are taken off the guess of what weights save, which is too good: within 5 cm on drive 0013 it
was 0.023 where later frames took none less (research/notes/steps-along-directions.md)."""
WAITING: Final = 8
"""Frames whose samples wait to be learned from; older ones are left out."""
CHECK_STEPS: Final = 400
"""Steps from one look at what they brought to the next."""
LEAST_HELD: Final = 5000
"""Samples to measure on, before anything is offered."""
FINENESS: Final = ((7, 8, 8, 5), (7, 7, 7, 4), (6, 6, 6, 3))
"""How finely differences to the weights before are sent, bits behind the point: of the three layers, and of biases of
rows and scales; what saves most in the end is taken."""
PAID_BACK: Final = 600
"""Frames in which an update has to save what it costs to send: a minute."""

Waiting = TypeVar("Waiting")


@dataclass(frozen=True, eq=False)
class Offer:
    """Weights to be used from the next frame on. update: how they are sent; None: the ones that it all began with."""

    weights: Weights
    nets: NativeNets
    update: Update | None
    gain: float


class Learner:
    """Trains the network that most frames are coded with. One thread encodes, and one may learn at the same time.

    base: weights that decoders have; nets: those in use; expects: which of them most frames are coded with
    of: names what it was made for; key_interval: frames from one key message to the next
    """

    def __init__(self, base: Weights, nets: list[Net], *, expects: bool) -> None:
        self.of = base.name, nets[0].size, expects
        self._base, self._nets = base, {net.expects: net for net in nets}
        self._net = self._nets[expects]
        self.key_interval = 50
        self._trainer = NetTrainer([layer.given for layer in self._net.layers], TRAINING, seed=1)
        self._waiting: deque[tuple[ReturnSamples, bool]] = deque()
        self._beginning = Offer(base, native_nets(nets), None, 0.0)
        self._now = self._beginning  # what the encoder uses, or is about to use
        self._offered: deque[Offer] = deque()
        self._frames = self._returns = self._frames_left_out = 0
        self._drawn = 0  # samples, since the last frame
        self._checked_at = self._updates = 0

    def samples_of(self, frame: Frame, *, expects: bool) -> ReturnSamples | None:
        """What is to take samples while a frame is coded; None where it is coded by another network."""
        if expects != self._net.expects or not frame.points:
            return None
        wanted = HELD_SAMPLES if self._is_held(self._frames + 1) else max(SAMPLES, self._drawn // DRAWS)
        return ReturnSamples(wanted / frame.points, seed=frame.index * 2654435761 + 1)

    def take(self, samples: ReturnSamples, returns: int) -> None:
        """Samples of a frame that was coded, of so many returns."""
        self._frames += 1
        self._returns, self._drawn = returns, 0
        self._waiting.append((samples, self._is_held(self._frames)))
        while len(self._waiting) > WAITING and _first(self._waiting) is not None:
            self._frames_left_out += 1

    @staticmethod
    def _is_held(number: int) -> bool:
        return number % HELD_EVERY == 0

    def offer(self, offer: Offer) -> None:
        """Weights for the next that asks."""
        self._offered.append(offer)

    def offered(self) -> Offer | None:
        """Weights that are better than those in use; each is given once."""
        return _first(self._offered)

    def learn(self, steps: int, budget_ms: float | None = None) -> int:
        """Take at most so many steps, none of them begun after so long; how many it took. Now and then looks at what
        they brought, which takes up to 50 ms more; with a budget it then comes back."""
        while (waiting := _first(self._waiting)) is not None:
            samples, held = waiting
            self._trainer.add(samples, held=held)
        done = 0
        while done < steps:
            until = CHECK_STEPS - (self._trainer.steps - self._checked_at)
            took = self._trainer.train(min(until, steps - done), budget_ms)
            done += took
            self._drawn += took * TRAINING.batch
            if self._trainer.steps - self._checked_at >= CHECK_STEPS:
                self._checked_at = self._trainer.steps
                self._check()
            if took < until or budget_ms is not None:
                break
        return done

    def report(self) -> dict[str, Any]:
        """For the status: what was learned, what was sent and what it brings."""
        return {
            "steps": self._trainer.steps,
            "samples": self._trainer.samples,
            "frames_left_out": self._frames_left_out,
            "updates": self._updates,
            "update_bytes": 0 if self._now.update is None else len(self._now.update.data),
            "gain_bits": round(self._now.gain, 4),
        }

    def _check(self) -> None:
        """Offer what saves most, sending counted, if that is not what is in use already."""
        if self._trainer.held < LEAST_HELD or self._offered:
            return
        before, now = self._cost(self._beginning.nets), self._cost(self._now.nets)
        best, most = self._now, self._saved(self._now, before - now, sent=True)
        for offer in [self._beginning, *self._trained(before)]:
            saved = self._saved(offer, offer.gain, sent=offer.update is None)
            if offer is not self._now and saved > most:
                best, most = offer, saved
        if best is not self._now:
            self._updates += best.update is not None
            self._now = best
            self.offer(best)

    def _trained(self, before: float) -> list[Offer]:
        found = []
        for fineness in FINENESS:
            try:
                net = quantised(self._net.expects, self._net.size, self._trainer.layers(), self._trainer.cases())
                nets = [net if old.expects == net.expects else old for old in self._nets.values()]
                update = update_of(self._base, nets, fineness)
                native = native_nets(list(update.weights.nets))
            except (SectionError, SettingsError):  # weights that whole numbers cannot hold: those in use stay
                continue
            found.append(Offer(update.weights, native, update, before - self._cost(native)))
        return found

    def _cost(self, nets: NativeNets) -> float:
        return self._trainer.cost(nets, BESIDE_ANEW)

    def _saved(self, offer: Offer, gain: float, *, sent: bool) -> float:
        """Bits of a frame that weights save, without those of sending them with each key message, and once before."""
        size = 0 if offer.update is None else 8 * len(offer.update.data)
        sure = gain if offer.update is None else gain - DOUBT
        return sure * self._returns - size / self.key_interval - (0 if sent else size / PAID_BACK)


def _first(waiting: deque[Waiting]) -> Waiting | None:
    """What waits longest, taken out; None where nothing waits. In one step: two threads may ask."""
    try:
        return waiting.popleft()
    except IndexError:
        return None
