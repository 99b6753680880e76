// What the page does beyond its forms, which work without it: keep the draft, show the fields that count,
// follow an identification. What is shown is a page of the server, put in the place of the old one.
"use strict";

const all = (selector, root = document) => [...root.querySelectorAll(selector)];
const busy = document.getElementById("busy");

function say(text) {
  busy.textContent = text;
  busy.hidden = !text;
}

async function read(address, options) {
  const answer = await fetch(address, options);
  return new DOMParser().parseFromString(await answer.text(), "text/html");
}

// The draft is kept at each change. A choice decides which fields count, so that the form is shown anew, with the focus,
// the selection and the open parts where they were; one whose answer comes after the next change is passed over.
let edits = 0, chosen = false, timer = 0, unkept = null;

async function keep(form, leaving = false) {
  clearTimeout(timer);
  unkept = null;
  const now = edits;
  const body = new URLSearchParams(new FormData(form));
  const page = await read(form.dataset.draft, { method: "POST", body, keepalive: leaving }).catch(() => null);
  if (!page || !chosen || now !== edits || page.querySelector(".fault, .faults")) return;
  chosen = false;
  const fresh = page.querySelector("main"), focus = document.activeElement;
  for (const part of all("details[open]")) {
    const same = fresh.querySelector(`[id="${part.id}"]`);
    if (same) same.open = true;
  }
  document.querySelector("main").replaceWith(fresh);
  const same = focus.id && document.getElementById(focus.id);
  if (same) {
    same.value = focus.value;
    same.focus({ preventScroll: true });
    same.setSelectionRange?.(focus.selectionStart, focus.selectionEnd);
  }
}

document.addEventListener("input", (event) => {
  const form = event.target.closest("form[data-draft]");
  if (!form) return;
  edits += 1;
  const wrong = event.target.closest(".wrong");  // no more: the next check judges what is entered now
  if (wrong) {
    wrong.classList.remove("wrong");
    event.target.removeAttribute("aria-invalid");
    all(".fault", wrong).forEach((said) => said.remove());
  }
  chosen ||= event.target.matches("select, #transmission-ratio");  // a gear asks for the side of positions
  unkept = form;
  clearTimeout(timer);
  timer = setTimeout(() => keep(form), event.target.matches("select") ? 0 : 300);
});
window.addEventListener("pagehide", () => { if (unkept) keep(unkept, true); });

document.addEventListener("submit", (event) => {
  const form = event.target;
  unkept = null;
  clearTimeout(timer);
  if (form.dataset.busy) say(`${form.dataset.busy} ...`);
  for (const button of all("button", form)) setTimeout(() => { button.disabled = true; });
});

// Coming back by the browser's arrow finds a page that works.
window.addEventListener("pageshow", () => {
  say("");
  for (const button of all("button")) button.disabled = false;
});

for (const zone of all("[data-drop]")) {
  const over = (on) => zone.classList.toggle("over", on);
  zone.addEventListener("dragover", (event) => { event.preventDefault(); over(true); });
  zone.addEventListener("dragleave", () => over(false));
  zone.addEventListener("change", () => zone.closest("form").requestSubmit());
  zone.addEventListener("drop", (event) => {
    event.preventDefault();
    over(false);
    if (!event.dataTransfer.files.length) return;
    zone.querySelector('input[type="file"]').files = event.dataTransfer.files;
    zone.closest("form").requestSubmit();
  });
}

// An identification is followed line by line; when there is an answer, and at its end, its page is read anew.
const run = document.querySelector("[data-poll]");
async function follow() {
  const page = await read(location.href).catch(() => null);
  if (page && page.querySelector("[data-poll]")?.dataset.poll !== run.dataset.poll) location.reload();
  for (const part of page ? all("[data-live]") : []) {
    const fresh = page.getElementById(part.id);
    if (fresh && fresh.textContent !== part.textContent) part.replaceChildren(...fresh.childNodes);
    part.scrollTop = part.scrollHeight;
  }
  setTimeout(follow, 1000);
}
if (run) setTimeout(follow, 1000);

const faults = document.querySelector("[data-focus]") || document.querySelector('[aria-invalid="true"]');
if (faults) faults.focus();
