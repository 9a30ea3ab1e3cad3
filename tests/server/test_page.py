"""How the page is served: nothing from elsewhere, nothing twice, and to everybody."""

from __future__ import annotations

import gzip
import re

from lidarcodec_server.web_files import web_files


def script_of(html: str) -> str:
    return re.search(r'src="\./(assets/[^"]+\.js)"', html)[1]


async def test_the_page_and_all_it_names_are_served(serving):
    async with serving() as client:
        front = await client.get("/")
        assert front.status_code == 200
        assert front.headers["content-type"] == "text/html; charset=utf-8"
        named = re.findall(r'(?:src|href)="\./([^"]+)"', front.text)
        assert len(named) >= 3
        for name in named:
            if name != "docs":
                assert (await client.get(f"/{name}")).status_code == 200, name


async def test_nothing_but_this_servers_files_may_run_in_the_page(serving):
    async with serving() as client:
        policy = (await client.get("/")).headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe-inline" not in policy
    assert "frame-ancestors 'none'" in policy


async def test_a_browser_loads_a_script_once_and_asks_for_the_page_each_time(serving):
    async with serving() as client:
        front = await client.get("/")
        assert front.headers["cache-control"] == "no-cache"
        again = await client.get("/", headers={"If-None-Match": front.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")
        script = await client.get(f"/{script_of(front.text)}")
        assert "immutable" in script.headers["cache-control"]
        assert script.headers["content-type"].startswith("text/javascript")


async def test_scripts_are_compressed_for_those_who_can_read_it(serving):
    async with serving() as client:
        name = script_of((await client.get("/")).text)
        plain = await client.get(f"/{name}", headers={"Accept-Encoding": "identity"})
        packed = await client.get(f"/{name}", headers={"Accept-Encoding": "gzip"})
        assert packed.headers["content-encoding"] == "gzip"
        assert int(packed.headers["content-length"]) < len(plain.content) / 2
        assert packed.content == plain.content
    assert gzip.decompress(web_files()[name].compressed) == plain.content


async def test_what_is_no_file_of_the_page_is_a_problem_and_no_file_of_the_machine(serving):
    async with serving() as client:
        for name in ("nothing.js", "..%2fsources.json", "..%2f..%2fapp.py", "%2fetc%2fpasswd"):
            answer = await client.get(f"/assets/{name}")
            assert answer.status_code == 404
            assert answer.headers["content-type"] == "application/problem+json"
