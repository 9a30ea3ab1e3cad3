"""What a page would lose that decodes `riddle` itself: the networks that messages name and do not bring."""

from __future__ import annotations

from lidarcodec.network.shelf import shipped
from lidarcodec.network.weight_file import unpack_weights

WEIGHTS = "/api/v1/codecs/riddle/weights"


async def test_weights_of_the_package_come_by_their_name_and_may_be_kept(serving):
    async with serving() as client:
        answers = {name: await client.get(f"{WEIGHTS}/{name}") for name in shipped()}
    assert answers
    for name, answer in answers.items():
        assert answer.status_code == 200
        assert unpack_weights(answer.content).name == name
        assert "immutable" in answer.headers["cache-control"]


async def test_weights_of_another_name_are_not_there(serving):
    async with serving() as client:
        answer = await client.get(f"{WEIGHTS}/{'0' * 16}")
        assert (await client.get(f"{WEIGHTS}/NoHex")).status_code == 422
    assert answer.status_code == 404
    assert answer.json()["detail"].endswith("they arrive with the stream that uses them")
