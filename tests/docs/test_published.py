"""The site's versions, its address and llms.txt."""

from __future__ import annotations

import json
import re
import sys

from tests.docs.blocks import ROOT

sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import published


def test_the_switcher_has_every_version_of_the_changelog_at_one_address() -> None:
    place = "https://docs.example/jointid"
    assert published.options("", "1.2.0") == {}
    switcher = published.options(place, "1.2.0")["switcher"]
    assert switcher == {"json_url": f"{place}/versions.json", "version_match": "1.2.0"}
    found = published.versions("# Changelog\n\n## 1.2.0\n\ntext\n\n## 1.1.3 (2030-01-02)\n", place)
    assert [one["url"] for one in found] == [f"{place}/1.2.0/", f"{place}/1.1.3/"]
    assert [one.get("preferred", False) for one in found] == [True, False]
    json.dumps(found)
    from jointid import __version__

    newest = published.versions((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), place)[0]
    assert newest["version"] == __version__, "the switcher would not find this version"


def test_llms_txt_says_what_each_page_of_the_start_page_is_for() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    text = published.llms(index, "https://docs.example/0.3.0/")
    assert text.startswith("# jointid\n\n> jointid identifies the inertias")
    assert "\n- [Tuning](https://docs.example/0.3.0/tuning.html): set gains, a notch or a feed-forward\n" in text
    pages = re.findall(r"\]\((https://docs\.example/0\.3\.0/)?([\w/.-]+)\.html\)", text)
    assert len(pages) > 25
    assert all(base and (ROOT / "docs" / f"{page}.md").is_file() for base, page in pages)
    assert text.count("\n## ") == index.count("\n## ")
