"""The site has every page, and every public name."""

import re
from pathlib import Path

import pytest

import rtin

DOCS = Path(__file__).parent.parent / "docs"
WRITTEN = {page.stem for page in DOCS.glob("*.md")} - {"index"}


def named_in_the_reference():
    text = (DOCS / "reference.md").read_text(encoding="utf-8")
    return re.findall(r"^\.\. auto(class|function):: (\w+)$", text, re.M)


def listed_pages():
    text = (DOCS / "index.md").read_text(encoding="utf-8")
    lines = "\n".join(re.findall(r"^```\{toctree\}\n(.*?)^```", text, re.S | re.M)).splitlines()
    return [line for line in lines if line and not line.startswith(":")]


def test_every_public_name_is_in_the_reference_once():
    names = [name for _, name in named_in_the_reference()]
    assert sorted(names) == sorted(set(rtin.__all__) - {"__version__"})


@pytest.mark.parametrize(("kind", "name"), named_in_the_reference())
def test_the_reference_tells_classes_from_functions(kind, name):
    assert (kind == "class") == isinstance(getattr(rtin, name), type)


def test_the_contents_list_every_page_once_and_no_other():
    made_by_the_build = {"auto_gallery/index"}
    assert sorted(listed_pages()) == sorted(WRITTEN | made_by_the_build)
