"""The one reader of XML that comes from elsewhere.

Entities turn a few bytes into much, or into other files; deep nesting fills the stack.

>>> read_xml(b"<a><b>3</b></a>", most_elements=10).findtext("b")
'3'
>>> read_xml(b'<!DOCTYPE a [<!ENTITY b "b">]><a/>', most_elements=10)
Traceback (most recent call last):
  ...
lidarcodec.untrusted.xml.XmlRefusedError: it declares XML entities
"""

from __future__ import annotations

from typing import Final
from xml.etree import ElementTree
from xml.parsers import expat

MAX_DEPTH: Final = 32


class XmlRefusedError(ValueError):
    """No XML, or XML beyond the limits; the text completes "the file is refused: ..."."""


def read_xml(data: bytes, *, most_elements: int) -> ElementTree.Element:
    """The root element of a document without declarations of entities, nested at most 32 deep.

    Raises XmlRefusedError, a ValueError, for everything else, and nothing but that.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    depth = elements = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if elements > most_elements or depth > MAX_DEPTH:
            raise XmlRefusedError(f"it has more than {most_elements} elements or {MAX_DEPTH} levels")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def entity(*_declaration: object) -> None:
        raise XmlRefusedError("it declares XML entities")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.EntityDeclHandler = builder.data, entity
    try:
        parser.Parse(data, True)
    except XmlRefusedError:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise XmlRefusedError(f"it is not valid XML: {error}") from error
    return builder.close()
