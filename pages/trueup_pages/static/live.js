// What others do appears without a reload: an open page listens to what is added to the log.
"use strict";

(() => {
  const SETTLED_MS = 400; // several entries that come together change the page once
  const FIRST_TRY_MS = 3000; // after a stream was refused; each time twice as long
  const LAST_TRY_MS = 60000;
  const page = () => document.getElementById("main");
  const mode = () => page()?.dataset.live;
  const plant = location.pathname.match(/^\/plants\/([^/]+)/)?.[1];
  const home = plant ? `/plants/${plant}` : "/";
  let source = null;
  let last = null; // the entry of the log that the page, or the stream, has come to
  let wait = FIRST_TRY_MS;
  let retrying = null;
  let settling = null;
  let reading = 0; // counts how often the page was read anew: an older answer is dropped

  /** Whether the page is the response to a form, which says why that was refused: there is no
   * reading it anew. */
  const isResponseToForm = () => page().dataset.log === undefined;

  /** Whether somebody is at work on the page: reading it anew would take that away. */
  function isAtWork() {
    const focused = document.activeElement;
    if (page().contains(focused) && /^(INPUT|SELECT|TEXTAREA)$/.test(focused.tagName)) return true;
    if (String(getSelection()) || page().querySelector(":active")) return true;
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

  /** Puts a line above the page, with a link. */
  function put(notice, words, href, label) {
    const link = document.createElement("a");
    link.href = href;
    link.textContent = label;
    notice.replaceChildren(`${words} `, link);
    if (!notice.isConnected) page().before(notice);
  }

  function newNotice(kind, role) {
    const notice = document.createElement("p");
    notice.className = `notice live ${kind}`;
    notice.setAttribute("role", role);
    return notice;
  }

  /** Says what happened; the newest takes the place of what was said before. */
  function say(words) {
    const notice = document.querySelector(".live.entry") || newNotice("entry", "status");
    put(notice, words, isResponseToForm() ? home : location.href, "Show it");
  }

  /** Says that a plant has an alarm, which stays until it is looked at. */
  function sayAlarm(alarm) {
    const ours = [...document.querySelectorAll(".live.alarm")];
    const notice =
      ours.find((n) => n.dataset.plant === alarm.plant) || newNotice("alarm bad", "alert");
    notice.dataset.plant = alarm.plant;
    put(notice, alarm.words, `/plants/${encodeURIComponent(alarm.plant)}/monitor`, "Look");
  }

  /** The page as it is now, or null where it cannot be had. */
  async function pageNow() {
    try {
      const answer = await fetch(location.href, { headers: { Accept: "text/html" } });
      if (!answer.ok || answer.redirected) return null;
      const read = new DOMParser().parseFromString(await answer.text(), "text/html");
      return read.getElementById("main");
    } catch {
      return null; // the server does not answer
    }
  }

  /** Reads the page anew, in place: open sections and the focus stay. */
  async function refresh(words) {
    const mine = ++reading;
    const next = await pageNow();
    if (mine !== reading) return;
    if (!next || isAtWork() || isResponseToForm()) return say(words);
    const called = (summary) => summary.textContent.replace(/\d+/g, ""); // a count may grow
    const open = [...page().querySelectorAll("details[open] > summary")].map(called);
    for (const summary of next.querySelectorAll("details > summary")) {
      if (open.includes(called(summary))) summary.parentElement.open = true;
    }
    const focused = twin(document.activeElement, next);
    document.querySelector(".live.entry")?.remove();
    page().replaceWith(document.adoptNode(next));
    htmx.process(page());
    focused?.focus({ preventScroll: true });
    document.dispatchEvent(new Event("htmx:after:swap"));
  }

  /** The element of a page read anew that an element of the page was. */
  function twin(element, next) {
    if (!element || element === page() || !page().contains(element)) return null;
    const same = (main) =>
      [...main.querySelectorAll(element.tagName)].filter(
        (e) =>
          e.textContent === element.textContent &&
          e.getAttribute("href") === element.getAttribute("href"),
      );
    return same(next)[same(page()).indexOf(element)] || null;
  }

  function onEntry(event) {
    const { words } = JSON.parse(event.data);
    const entry = Number(event.lastEventId);
    clearTimeout(settling);
    settling = setTimeout(() => {
      if (entry <= Number(page().dataset.log)) return; // the page has been read since
      if (mode() === "refresh" && !isAtWork() && !isResponseToForm()) refresh(words);
      else if (mode() !== "alarms") say(words);
    }, SETTLED_MS);
  }

  function onAlarm(event) {
    sayAlarm(JSON.parse(event.data));
    onEntry(event);
  }

  function listen() {
    if (source || document.hidden || !mode()) return;
    clearTimeout(retrying);
    last ??= page().dataset.log ?? null;
    const asked = new URLSearchParams();
    if (plant) asked.set("plant", decodeURIComponent(plant));
    if (last !== null) asked.set("after", last);
    source = new EventSource(`/live?${asked}`);
    source.addEventListener("error", onError);
    for (const [kind, heard] of [["entry", onEntry], ["alarm", onAlarm], ["at", null]]) {
      source.addEventListener(kind, (event) => {
        last = event.lastEventId;
        wait = FIRST_TRY_MS;
        heard?.(event);
      });
    }
  }

  /** Tries again later where the server refused: a browser does so by itself only after a stream
   * that broke off. */
  function onError() {
    if (source?.readyState !== EventSource.CLOSED) return;
    stop();
    retrying = setTimeout(listen, wait);
    wait = Math.min(2 * wait, LAST_TRY_MS);
  }

  // a browser opens few streams to one host, so pages that nobody sees give theirs back
  function stop() {
    clearTimeout(retrying);
    source?.close();
    source = null;
  }

  document.addEventListener("visibilitychange", () => (document.hidden ? stop() : listen()));
  addEventListener("pagehide", stop);
  addEventListener("pageshow", listen);
  document.addEventListener("DOMContentLoaded", listen);
  document.addEventListener("htmx:after:swap", listen);
})();
