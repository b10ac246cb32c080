// What others do appears without a reload: an open page listens to what is added to the log.
"use strict";

(() => {
  const SETTLED_MS = 400; // several entries that come together change the page once
  const page = () => document.getElementById("main");
  const mode = () => page()?.dataset.live;
  const plant = location.pathname.match(/^\/plants\/([^/]+)/)?.[1];
  let source = null;
  let last = null;
  let settling = null;

  /** Whether somebody is at work on the page: reading it anew would take that away. */
  function isAtWork() {
    const focused = document.activeElement;
    if (page().contains(focused) && /^(INPUT|SELECT|TEXTAREA)$/.test(focused.tagName)) return true;
    if (String(getSelection())) return true;
    return [...page().querySelectorAll("input, textarea, select")].some((field) =>
      field.type === "checkbox" || field.type === "radio"
        ? field.checked !== field.defaultChecked
        : field.tagName === "SELECT"
          ? [...field.options].some((o) => o.selected !== o.defaultSelected && !isFirst(field, o))
          : field.type === "file"
            ? field.files.length > 0
            : field.value !== field.defaultValue,
    );
  }

  /** Whether an option is the one that a list without a choice shows. */
  function isFirst(list, option) {
    return option.index === 0 && ![...list.options].some((o) => o.defaultSelected);
  }

  /** Says what happened, above the page; an alarm stays until it is looked at. */
  function say(words, href, kind) {
    let notice = document.querySelector(`.live.${kind}`);
    if (!notice) {
      notice = document.createElement("p");
      notice.className = `notice live ${kind}`;
      notice.setAttribute("role", kind === "alarm" ? "alert" : "status");
      page().before(notice);
    }
    const link = document.createElement("a");
    link.href = href;
    link.textContent = kind === "alarm" ? "Look" : "Show it";
    notice.classList.toggle("bad", kind === "alarm");
    notice.replaceChildren(`${words} `, link);
  }

  /** Reads the page anew, in place: sections that were open stay open. */
  async function refresh() {
    const answer = await fetch(location.href, { headers: { Accept: "text/html" } });
    if (!answer.ok || answer.redirected) return;
    const read = new DOMParser().parseFromString(await answer.text(), "text/html");
    const next = read.getElementById("main");
    if (!next || isAtWork()) return;
    const called = (summary) => summary.textContent.replace(/\d+/g, ""); // a count may grow
    const open = [...page().querySelectorAll("details[open] > summary")].map(called);
    for (const summary of next.querySelectorAll("details > summary")) {
      if (open.includes(called(summary))) summary.parentElement.open = true;
    }
    document.querySelector(".live.entry")?.remove();
    page().replaceWith(document.adoptNode(next));
    htmx.process(page());
    document.dispatchEvent(new Event("htmx:after:swap"));
  }

  function onEntry(event) {
    const { words } = JSON.parse(event.data);
    clearTimeout(settling);
    settling = setTimeout(() => {
      if (mode() === "refresh" && !isAtWork()) refresh();
      else say(words, location.href, "entry");
    }, SETTLED_MS);
  }

  function onAlarm(event) {
    const alarm = JSON.parse(event.data);
    say(alarm.words, `/plants/${encodeURIComponent(alarm.plant)}/monitor`, "alarm");
    onEntry(event);
  }

  function listen() {
    if (source || document.hidden || !mode()) return;
    const asked = new URLSearchParams();
    if (plant) asked.set("plant", decodeURIComponent(plant));
    if (last !== null) asked.set("after", last);
    source = new EventSource(`/live?${asked}`);
    for (const [kind, heard] of [["entry", onEntry], ["alarm", onAlarm], ["at", null]]) {
      source.addEventListener(kind, (event) => {
        last = event.lastEventId;
        heard?.(event);
      });
    }
  }

  // a browser opens few streams to one host, so pages that nobody sees give theirs back
  function stop() {
    source?.close();
    source = null;
  }

  document.addEventListener("visibilitychange", () => (document.hidden ? stop() : listen()));
  addEventListener("pagehide", stop);
  addEventListener("pageshow", listen);
  document.addEventListener("DOMContentLoaded", listen);
})();
