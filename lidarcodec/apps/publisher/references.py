"""References: which frames the followed receiver can decode, as far as it has reported: the next one may refer to them.

So a lost message costs itself: what follows refers to an earlier one that arrived, and needs no key frame.

>>> references = References()
>>> for index, needs in ((0, None), (1, 0), (2, 1), (3, 1)):
...     references.sent(index, needs)
>>> sorted(references.there())  # nothing is reported: it may refer to the one that needs none
[0]
>>> references.arrived([0, 2, 3]); sorted(references.there())  # 1 is lost, so that 2 and 3 cannot be decoded
[0]
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Set
from typing import Final

REMEMBERED: Final = 64


class References:
    """Frames since the last message that needs no other.

    begun: index of that message; -1 before the first
    """

    def __init__(self) -> None:
        self.begun = -1
        self._needs: OrderedDict[int, int | None] = OrderedDict()
        self._there: set[int] = set()

    def sent(self, index: int, needs: int | None, *, goes_on: bool = False) -> None:
        """A message is sent. needs: index of the frame that it refers to; goes_on: whether it takes the place of that,
        as a part of its turn"""
        if goes_on and needs == self.begun:
            self.begun = index
        elif needs is None:
            self.begun = index
            self._needs.clear()
            self._there.clear()
        self._needs[index] = needs
        while len(self._needs) > REMEMBERED:
            old, _ = self._needs.popitem(last=False)
            self._there.discard(old)

    def arrived(self, indices: Iterable[int]) -> None:
        """These messages arrived at the followed receiver."""
        for index in sorted(indices):
            needs = self._needs.get(index, -1)
            if needs is None or needs in self._there:
                self._there.add(index)

    def switched(self) -> None:
        """Another receiver is followed: what arrived there is not known."""
        self._there.clear()

    def there(self) -> Set[int]:
        """The frames to which the next one may refer. The message that needs no other is among them until it is known
        to be lost: else all that is sent before its report would have to begin anew."""
        return self._there | {self.begun}
