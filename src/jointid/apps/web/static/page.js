// What the page does beyond its forms, which work without it: keep the draft, show what counts, refuse large files,
// follow an identification. Everything that is shown is set as text, never as HTML.
"use strict";

const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const busy = document.getElementById("busy");

function say(text) {
  busy.textContent = text;
  busy.hidden = !text;
}

// Fields that count only beside others: hidden and not sent while they do not.
function valueOf(name) {
  const field = document.querySelector(`[name="${name}"]`);
  return field ? field.value : null;
}

function show() {
  for (const part of all("[data-when]")) {
    const counts = Object.entries(JSON.parse(part.dataset.when)).every(([name, values]) => {
      const value = valueOf(name);
      return value === null ? !part.hidden : values.includes(value) || (values.includes("*") && value !== "");
    });
    part.hidden = !counts;
    for (const field of all("input, select, textarea", part)) field.disabled = !counts;
  }
}

// The plot beside a channel is that of its column.
function draw(select) {
  const channel = select.closest("[data-channel]");
  if (!channel) return;
  const picture = channel.querySelector("img.plot");
  const chosen = select.selectedOptions[0];
  const source = chosen.dataset.plot;
  picture.hidden = !source;
  if (source) {
    picture.src = source;
    picture.alt = `${select.value} over the record`;
  }
  channel.querySelector(".empty").hidden = Boolean(select.value);
  channel.querySelector(".details").hidden = !select.value;
}

// A decimal comma is read; what it is read as is shown. The field's unit is not, behind one that is entered.
function plain(input) {
  const text = input.value.trim();
  if (/^[-+]?\d*,\d+([eE][-+]?\d+)?(\s*[^\d\s.,].*)?$/.test(text)) input.value = text.replace(",", ".");
}

// The draft is kept at each change, so that a reload finds it again.
let waiting = 0, unkept = null, sending = null;
function keep(form) {
  clearTimeout(waiting);
  unkept = form;
  waiting = setTimeout(flush, 300);
}

function flush() {
  clearTimeout(waiting);
  const form = unkept;
  unkept = null;
  if (!form) return;
  const body = new URLSearchParams(new FormData(form));
  const sent = fetch(form.dataset.draft, { method: "POST", body, keepalive: true }).catch(() => {});
  sending = sent;
  sent.finally(() => { if (sending === sent) sending = null; });
}

// A step that is left at once, by a link or by the browser's arrow, keeps what was typed last.
document.addEventListener("click", (event) => {
  const link = event.target.closest("a[href]");
  if (!(unkept || sending) || !link || link.target || event.defaultPrevented || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  flush();
  sending.finally(() => { location.href = link.href; });
});
window.addEventListener("pagehide", flush);

for (const form of all("form[data-draft]")) {
  form.addEventListener("input", () => keep(form));
  form.addEventListener("change", (event) => {
    const field = event.target.closest(".wrong");
    if (field) {
      field.classList.remove("wrong");
      event.target.removeAttribute("aria-invalid");
      field.querySelector(".fault").hidden = true;
    }
    if (event.target.matches("[data-column]")) draw(event.target);
    if (event.target.matches("[data-number]")) plain(event.target);
    show();
    keep(form);
  });
}

// A file that is too large is refused before it is sent.
function fits(form) {
  const files = [...form.querySelector('input[type="file"]').files];
  const most = Number(form.dataset.upload);
  const tooLarge = files.reduce((sum, file) => sum + file.size, 0) > most;
  form.querySelector("[data-too-large]").textContent = tooLarge
    ? `${files.map((file) => file.name).join(", ")} is larger than ${Math.floor(most / 2 ** 20)} MB, which is the most this page takes; cut it, or log it slower.`
    : "";
  return !tooLarge;
}

for (const form of all("form")) {
  form.addEventListener("submit", (event) => {
    if (form.dataset.upload && !fits(form)) {
      event.preventDefault();
      return;
    }
    if (form === unkept) unkept = null;
    flush();
    if (form.dataset.busy) say(`${form.dataset.busy} ...`);
    for (const button of all("button", form)) setTimeout(() => { button.disabled = true; });
  });
}

// Coming back by the browser's arrow finds a page that works.
window.addEventListener("pageshow", () => {
  say("");
  for (const button of all("button")) button.disabled = false;
});

for (const zone of all("[data-drop]")) {
  const input = zone.querySelector('input[type="file"]');
  const over = (on) => zone.classList.toggle("over", on);
  zone.addEventListener("dragover", (event) => { event.preventDefault(); over(true); });
  zone.addEventListener("dragleave", () => over(false));
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    over(false);
    if (!event.dataTransfer.files.length) return;
    input.files = event.dataTransfer.files;
    zone.closest("form").requestSubmit();
  });
}

// An identification is followed line by line; when there is an answer, and at its end, its page is read anew.
const run = document.querySelector("[data-run]");
if (run) {
  const log = run.querySelector(".log");
  const clock = run.querySelector("[data-clock]");
  const began = Date.now() - 1000 * Number(run.dataset.elapsed);
  if (clock) setInterval(() => { clock.textContent = `${Math.round((Date.now() - began) / 1000)} s`; }, 1000);
  if (log) log.replaceChildren();
  const source = new EventSource(run.dataset.run);
  source.addEventListener("message", (event) => {
    const said = JSON.parse(event.data);
    for (const last of all("[data-last]")) last.textContent = said;
    if (!log) return;
    const line = document.createElement("li");
    line.textContent = said;
    log.append(line);
    log.scrollTop = log.scrollHeight;
  });
  const leave = () => {
    source.close();
    location.reload();
  };
  source.addEventListener("answer", () => { if (!("answered" in run.dataset)) leave(); });
  source.addEventListener("end", leave);
  window.addEventListener("pagehide", () => source.close());
}

show();
for (const wrong of all('[aria-invalid="true"]').reverse()) {
  for (let part = wrong.closest("details"); part; part = part.parentElement.closest("details")) part.open = true;
}
const faults = document.querySelector("[data-focus]") || document.querySelector('[aria-invalid="true"]:not(:disabled)');
if (faults) faults.focus();
