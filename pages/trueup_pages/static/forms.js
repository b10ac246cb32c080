"use strict";

/*
 * Forms that need a script: files that are dropped and sent with their progress, and buttons that
 * copy. Everything else on a page works without this file.
 */

const CRC = new Uint32Array(256).map((_, n) => {
  for (let bit = 0; bit < 8; bit++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});
const LARGEST = 2 ** 32 - 2 ** 20; // of a zip archive without its 64-bit extension

/** The CRC-32 of a file, which is read part by part. */
async function crc32(file) {
  let crc = -1;
  const reader = file.stream().getReader();
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return ~crc >>> 0;
    for (const byte of value) crc = CRC[(crc ^ byte) & 255] ^ (crc >>> 8);
  }
}

function record(size, write) {
  const bytes = new Uint8Array(size);
  write(new DataView(bytes.buffer));
  return bytes;
}

/** A zip archive of files by their paths, stored as they are. */
async function zip(files) {
  const parts = [];
  const directory = [];
  let offset = 0;
  for (const { path, file } of files) {
    const name = new TextEncoder().encode(path);
    const crc = await crc32(file);
    const described = (view, at) => {
      view.setUint16(at, 20, true);
      view.setUint16(at + 2, 0x800, true); // names are UTF-8
      view.setUint32(at + 10, crc, true);
      view.setUint32(at + 14, file.size, true);
      view.setUint32(at + 18, file.size, true);
      view.setUint16(at + 22, name.length, true);
    };
    const local = record(30, (view) => {
      view.setUint32(0, 0x04034b50, true);
      described(view, 4);
    });
    const central = record(46, (view) => {
      view.setUint32(0, 0x02014b50, true);
      view.setUint16(4, 20, true);
      described(view, 6);
      view.setUint32(42, offset, true);
    });
    parts.push(local, name, file);
    directory.push(central, name);
    offset += local.length + name.length + file.size;
  }
  const size = directory.reduce((sum, part) => sum + part.length, 0);
  const end = record(22, (view) => {
    view.setUint32(0, 0x06054b50, true);
    view.setUint16(8, files.length, true);
    view.setUint16(10, files.length, true);
    view.setUint32(12, size, true);
    view.setUint32(16, offset, true);
  });
  return new Blob([...parts, ...directory, end]);
}

/** The files below what was dropped, with their paths. */
async function dropped(transfer) {
  const plain = [...transfer.files].map((file) => ({ path: file.name, file }));
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.length) return plain;
  const files = [];
  const walk = async (entry, path) => {
    if (entry.isFile) {
      const file = await new Promise((done, fail) => entry.file(done, fail));
      files.push({ path: path + file.name, file });
      return;
    }
    const reader = entry.createReader();
    for (;;) {
      const some = await new Promise((done, fail) => reader.readEntries(done, fail));
      if (!some.length) return;
      for (const one of some) await walk(one, `${path}${entry.name}/`);
    }
  };
  for (const entry of entries) await walk(entry, "");
  return files;
}

/** Sends a file; answers with the status and the JSON of the response. */
function send(url, file, show) {
  return new Promise((done) => {
    const request = new XMLHttpRequest();
    request.open("POST", url);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.upload.onprogress = (event) => show(event.loaded / Math.max(event.total, 1));
    request.onerror = () =>
      done([0, { detail: "The connection broke", hint: "Send it again.", code: "connection" }]);
    request.onload = () => {
      try {
        done([request.status, JSON.parse(request.responseText)]);
      } catch {
        const detail = `The service answered ${request.status}`;
        done([request.status, { detail, hint: "Send it again.", code: "unreadable" }]);
      }
    };
    request.send(file);
  });
}

/** A part of a page with text in it. */
function part(tag, text, kind = "") {
  const element = document.createElement(tag);
  element.className = kind;
  element.textContent = text;
  return element;
}

/** One line of what is being sent: its name, how far it is, and what came of it. */
class Line {
  constructor(place, name) {
    this.root = part("div", "", "sending");
    this.bar = part("progress", "");
    this.bar.max = 1;
    this.bar.setAttribute("aria-label", `sending ${name}`);
    this.said = part("span", "waiting", "pale");
    this.root.append(part("b", name), this.bar, this.said);
    place.append(this.root);
  }

  sent(share) {
    this.bar.value = share;
    this.said.textContent = share < 1 ? `sending, ${Math.floor(100 * share)} %` : "reading it";
    if (share >= 1) this.bar.removeAttribute("value");
  }

  done(...nodes) {
    this.bar.remove();
    this.said.replaceWith(...nodes);
  }

  refused(problem) {
    const facts = problem.facts || {};
    const where = ["file", "rule", "field", "byte", "topic", "channel", "limit"]
      .filter((name) => facts[name] != null)
      .map((name) => `${name} ${facts[name]}`);
    this.root.classList.add("bad");
    this.done(
      part("p", sentence(problem.detail)),
      part("p", problem.hint),
      part("p", [problem.code, ...where].join(" · "), "pale"),
    );
  }
}

/** What several files are called: their folder, or what their names begin with. */
function called(files) {
  const paths = files.map(({ path }) => path);
  if (paths.every((path) => path.includes("/"))) return paths[0].split("/")[0];
  let common = paths[0].replace(/\.[^.]*$/, "");
  for (const path of paths) while (!path.startsWith(common)) common = common.slice(0, -1);
  return common.replace(/[^A-Za-z0-9]+$/, "") || "recordings";
}

function sentence(text) {
  return text.charAt(0).toUpperCase() + text.slice(1) + (/[.?!]$/.test(text) ? "" : ".");
}

/** A form that files are dropped on. */
class Drop {
  constructor(root) {
    this.root = root;
    this.place = root.querySelector(".sent");
    const input = root.querySelector("input[type=file]");
    input.addEventListener("change", () => {
      const chosen = [...input.files].map((file) => ({ path: file.name, file }));
      input.value = "";
      this.take(chosen);
    });
    root.addEventListener("submit", (event) => event.preventDefault());
    root.addEventListener("dragover", (event) => {
      event.preventDefault();
      root.classList.add("over");
    });
    root.addEventListener("dragleave", () => root.classList.remove("over"));
    root.addEventListener("drop", async (event) => {
      event.preventDefault();
      root.classList.remove("over");
      this.take(await dropped(event.dataTransfer));
    });
  }

  take(files) {
    if (files.length === 0) return;
    if (this.root.dataset.drop === "draft") this.draft(files);
    else this.episodes(files);
  }

  async draft(files) {
    this.place.replaceChildren();
    const name = files.length === 1 ? files[0].file.name : `${called(files)}.zip`;
    const line = new Line(this.place, files.length === 1 ? name : `${files.length} files`);
    if (files.reduce((sum, { file }) => sum + file.size, 0) > LARGEST) {
      const hint = "Register the plant from one recording, and upload the others then.";
      line.refused({ detail: "Together they have more than 4 GiB", hint, code: "too-large" });
      return;
    }
    const body = files.length === 1 ? files[0].file : await zip(files);
    const url = `${this.root.dataset.to}?file=${encodeURIComponent(name)}`;
    const [status, answer] = await send(url, body, (share) => line.sent(share));
    if (status === 201) location.assign(this.root.dataset.then + answer.digest);
    else line.refused(answer);
  }

  async episodes(files) {
    const lines = files.map(({ path }) => new Line(this.place, path));
    for (const [i, { file }] of files.entries()) await this.episode(file, lines[i], "");
  }

  async episode(file, line, mapping) {
    const role = this.root.elements.role.value;
    if (!role && !/\.mcap$/i.test(file.name)) {
      const detail = `${file.name} does not say what it was recorded for`;
      const hint = "Choose what it is for above, and send it then.";
      this.refused(file, line, { detail, hint, code: "not-an-episode", facts: { rule: "role" } });
      return;
    }
    const query = new URLSearchParams({ name: file.name });
    if (role) {
      query.set("role", role);
      query.set("conditions", JSON.stringify(this.conditions()));
    }
    if (mapping) query.set("mapping", mapping);
    const url = `${this.root.dataset.to}?${query}`;
    const [status, answer] = await send(url, file, (share) => line.sent(share));
    if (status !== 200 && status !== 201) {
      this.refused(file, line, answer);
      return;
    }
    const link = part("a", `${status === 201 ? "uploaded" : "known already"}: ${answer.role}`);
    link.href = this.root.dataset.then + answer.digest;
    const seconds = Number(answer.summary.duration_s.toPrecision(3));
    line.done(link, part("span", ` ${answer.summary.samples} samples, ${seconds} s`, "pale"));
  }

  /** Shows why a file was refused, and where more has to be said of it a button to send it again. */
  refused(file, line, problem) {
    line.refused(problem);
    const proposed = problem.facts?.mapping;
    if (!proposed && problem.facts?.rule !== "role") return;
    const again = part("button", proposed ? "Use these signals" : "Send it with the role above");
    again.type = "button";
    again.addEventListener("click", () => {
      const retry = new Line(this.place, file.name);
      line.root.replaceWith(retry.root);
      this.episode(file, retry, proposed);
    });
    line.root.append(again);
  }

  conditions() {
    const fields = [...this.root.querySelectorAll("[data-condition]")];
    const given = fields.filter((field) => field.value.trim());
    return Object.fromEntries(given.map((f) => [f.dataset.condition, f.value.trim()]));
  }
}

async function copy(button) {
  try {
    await navigator.clipboard.writeText(button.dataset.copy);
  } catch {
    const field = part("textarea", button.dataset.copy);
    document.body.append(field);
    field.select();
    document.execCommand("copy"); // where a page is not served over TLS
    field.remove();
  }
  const before = button.textContent;
  button.textContent = "Copied";
  setTimeout(() => (button.textContent = before), 1500);
}

document.addEventListener("click", (event) => {
  const button = event.target.closest("[data-copy]");
  if (button) copy(button);
});
// a second click of an impatient person would do the same twice
document.addEventListener("submit", (event) => {
  const pressed = event.submitter;
  if (event.target.method !== "post" || !pressed) return;
  setTimeout(() => (pressed.disabled = true)); // once the form was sent with what was pressed
});
addEventListener("pageshow", (event) => {
  if (!event.persisted) return; // the page of before, by the button "back"
  for (const button of document.querySelectorAll("form[method=post] button")) button.disabled = false;
});
for (const root of document.querySelectorAll("form[data-drop]")) new Drop(root);
