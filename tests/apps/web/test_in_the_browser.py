"""The page in a real browser: end to end on the EMPS record, by keyboard alone, and on a tablet."""

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.browser import opened
from tests.rigid_axis import run

pytestmark = pytest.mark.browser

LAW = {"position_gain": "160.18", "velocity_gain": "243.45", "gain": "35,15065188", "limit": "10"}
PATIENCE = 240_000  # ms
DESK, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """The page, served by the command."""
    folder = tmp_path / "page"
    program = "import sys; from jointid.apps.cli import main; main(sys.argv[1:])"
    words = [sys.executable, "-c", program, "serve", "--port", "0", "--folder", str(folder)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        found = re.search(r"http://127\.0\.0\.1:\d+/[\w-]+/", process.stdout.readline())
        yield found[0]
        process.terminate()


@dataclass
class Visit:
    """A person with a fresh browser; what the page complains of, and where it asks, is written down."""

    page: Any
    complaints: list[str]
    address: str
    size: dict[str, int]

    def looked_at(self, name: str) -> None:
        """Nothing is wider than the screen, of a desk or of a phone."""
        for size in (DESK, PHONE):
            self.page.set_viewport_size(size)
            wide, screen = self.page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
            assert wide <= screen, (name, size)
        self.page.set_viewport_size(self.size)

    def on(self, path: str) -> None:
        self.page.wait_for_url(re.compile(re.escape(self.address) + path + r"(\?.*)?$"))

    def field(self, name: str) -> Any:
        return self.page.locator(f'[name="{name}"]')


@pytest.fixture
def visit(address: str, request: pytest.FixtureRequest) -> Iterator[Visit]:
    size = getattr(request, "param", DESK)
    with opened(address, viewport=size) as (page, complaints):
        page.set_default_timeout(60_000)
        yield Visit(page, complaints, address, size)


def upload(visit: Visit, record: Path) -> None:
    visit.page.set_input_files("#file", record)
    visit.on("channels")


def map_torque(visit: Visit) -> None:
    visit.field("joint.kind").select_option("prismatic")
    for channel, column in {"torque": "vir", "reference": "qg", "motor_position": "qm"}.items():
        visit.field(f"record.channels.{channel}.column").select_option(column)
        visit.field(f"record.channels.{channel}.unit").select_option("N" if column == "vir" else "m")
    gain = visit.field("record.channels.torque.gain")
    if not gain.is_visible():
        visit.page.get_by_text("More about the torque").click()
    gain.fill("35,15065188")
    gain.blur()


def fill_in_controller(visit: Visit) -> None:
    for key, word in {"joint.model": "rigid", "controller.law": "cascade"}.items():
        visit.field(key).select_option(word)
    for key, value in LAW.items():
        visit.field(f"controller.{key}").fill(value)
    visit.page.get_by_text("Further lines of the joint file").click()
    visit.field("extra").fill("controller.velocity_filter = [0.5, 0.5]")


@pytest.mark.parametrize("visit", [PHONE], indirect=True)
def test_emps_end_to_end(visit: Visit, emps_path: Path, tmp_path: Path) -> None:
    """On a phone, where everything is harder to reach."""
    page = visit.page
    visit.looked_at("1-record")
    upload(visit, emps_path)
    # A slow machine keeps an earlier draft first, without the gain.
    with page.expect_response(lambda answer: "35%2C15065188" in (answer.request.post_data or "")):
        map_torque(visit)
    drawn = "[...document.querySelectorAll('.channel img[src]')].filter(image => image.naturalWidth > 0).length"
    for _ in range(100):  # the policy of the page lets no test wait in it
        if page.evaluate(drawn) == 3:
            break
        page.wait_for_timeout(100)
    assert page.evaluate(drawn) == 3
    visit.looked_at("2-channels")
    page.reload()
    assert visit.field("record.channels.torque.gain").input_value() == "35,15065188"
    page.get_by_role("button", name="Check, and go on").click()
    visit.on("joint")
    fill_in_controller(visit)
    visit.looked_at("3-joint")
    page.get_by_role("button", name="Identify").click()
    visit.on("runs/1")
    visit.looked_at("4-identify")
    page.reload()
    page.wait_for_selector("p.found", timeout=PATIENCE)
    assert "is being written" in page.inner_text("[data-poll]")  # the answer does not wait for the report
    page.wait_for_selector("iframe", timeout=PATIENCE)
    assert page.inner_text("p.found") == "Inertia 95.4 ± 1.3 kg."
    assert "ely on it" in page.inner_text("p.trust")
    visit.looked_at("5-answer")
    frame = page.frame_locator("iframe")
    frame.get_by_role("heading", level=1).wait_for(timeout=PATIENCE)
    visit.looked_at("6-report")
    page.locator("iframe").evaluate("frame => frame.scrollIntoView()")
    frame.get_by_role("heading", level=2).first.wait_for()
    with page.expect_download() as downloading:
        page.get_by_role("link", name="Joint file").click()
    downloading.value.save_as(joint := tmp_path / "joint.toml")
    assert run("identify", joint, "--record", emps_path, "--json", tmp_path / "again.json", "-q") == 0
    again = json.loads((tmp_path / "again.json").read_text(encoding="utf-8"))
    answer = page.context.request.get(f"{visit.address}runs/1/answer.json").json()
    assert again["parameters"] == answer["parameters"]
    assert visit.complaints == []


def tab_to(visit: Visit, selector: str) -> None:
    """Press Tab until the focus is there; it must be seen on its way."""
    for _ in range(120):
        visit.page.keyboard.press("Tab")
        if visit.page.evaluate("selector => document.activeElement?.matches(selector)", selector):
            outline = visit.page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
            assert outline != "none", selector
            return
    raise AssertionError(f"Tab never reaches {selector}")


def test_by_keyboard_alone(visit: Visit) -> None:
    page, keys = visit.page, visit.page.keyboard
    keys.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    keys.press("Enter")
    assert page.evaluate("document.activeElement.id") == "content"
    tab_to(visit, "#file")
    tab_to(visit, 'form[action$="/example"] button')
    keys.press("Enter")
    visit.on("channels")
    tab_to(visit, '[name="joint.kind"]')
    tab_to(visit, '[name="record.channels.torque.column"]')
    tab_to(visit, 'form[action$="/channels"] button.primary')
    keys.press("Enter")
    visit.on("joint")
    tab_to(visit, '[name="joint.model"]')
    keys.press("Home")  # rigid: its frequency no longer counts
    assert visit.field("joint.model").input_value() == ""
    tab_to(visit, '[name="controller.position_gain"]')
    keys.press("Control+A")
    keys.type("fast")
    tab_to(visit, 'form[action$="/joint"] button.primary')
    keys.press("Enter")
    page.wait_for_selector(".fault:visible")
    page.go_back()
    page.go_forward()
    page.wait_for_selector("[name='controller.position_gain']:focus")  # the focus is at the fault
    keys.press("Control+A")
    keys.type("160.18")
    assert page.query_selector(".wrong, .fault, [aria-invalid]") is None  # until the next check
    tab_to(visit, 'form[action$="/joint"] button.primary')
    keys.press("Enter")
    visit.on("runs/1")
    tab_to(visit, 'form[action$="/runs/1"] button')
    keys.press("Enter")
    page.wait_for_selector("h1:has-text('Cancelled')")


def test_a_file_that_is_dropped_is_read(visit: Visit) -> None:
    visit.page.evaluate(
        """() => {
            const data = new DataTransfer();
            const rows = Array.from({ length: 200 }, (_, i) => `${i / 1000};${Math.sin(i)};${i * i};${i}`);
            data.items.add(new File([["t;force;x_ref;pos_act", ...rows].join("\\n")], "dropped.csv"));
            const zone = document.querySelector("[data-drop]");
            for (const type of ["dragover", "drop"]) {
                zone.dispatchEvent(new DragEvent(type, { dataTransfer: data, bubbles: true }));
            }
        }"""
    )
    visit.on("channels")
    assert "dropped.csv" in visit.page.inner_text(".lead")
    assert visit.field("record.channels.torque.column").input_value() == "force"  # it alone has such a name
    visit.page.get_by_text("A gear, a belt or a screw").click()
    visit.field("transmission.ratio").fill("50")
    for name in ("reference", "motor_position"):  # whose they are is asked as soon as there is a gear
        visit.field(f"record.channels.{name}.side").wait_for()
    assert visit.complaints == [] and visit.page.context.cookies() == []
    blocked = visit.page.evaluate(
        "new Promise(done => { addEventListener('securitypolicyviolation', e => done(e.effectiveDirective));"
        "const s = document.createElement('script'); s.textContent = 'window.ran = true'; document.body.append(s); })"
    )
    assert blocked.startswith("script-src") and visit.page.evaluate("window.ran === undefined")
