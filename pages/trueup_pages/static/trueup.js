// What pages do beyond links and forms: browse recordings, and sign in by a link.
"use strict";

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const digits = (x) => (x == null ? "–" : Number(x).toPrecision(4));

/** The recordings of a diagnosis: for each channel a plot of its signal and one of its errors,
 * with one cursor for all. */
class Recordings {
  constructor(root, data) {
    this.root = root;
    this.data = data;
    this.models = data.models.map((m) => [m.key, `--${m.kind}`]);
    this.lines = [["measured", "--ink"], ...this.models];
    this.select = root.querySelector("select");
    this.range = root.querySelector("input[type=range]");
    this.output = root.querySelector("output");
    this.plots = root.querySelector(".plots");
    this.values = root.querySelector(".values");
    this.select.addEventListener("change", () => this.draw());
    this.range.addEventListener("input", () => this.scrub(Number(this.range.value)));
    root.querySelector("[data-whole]").addEventListener("click", () => this.draw());
    root.querySelector(".still").hidden = true;
    root.querySelector(".live").hidden = false;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    let width = root.clientWidth;
    addEventListener("resize", () => {
      if (root.clientWidth !== width) {
        width = root.clientWidth;
        this.draw();
      }
    });
    this.draw();
  }

  draw() {
    const episode = (this.episode = this.data.episodes[Number(this.select.value)]);
    for (const plot of this.charts || []) plot.destroy();
    this.plots.replaceChildren();
    this.charts = [];
    for (const channel of episode.channels) {
      const unit = channel.unit && channel.unit !== "1" ? ` [${channel.unit}]` : "";
      const signals = this.lines.map(([name, of]) => [name, of, channel[name]]);
      const flat = (y) => episode.t_s.map(() => y);
      const bounds = (channel.envelope || []).map((y) => ["envelope", "--bad", flat(y), [5, 4]]);
      this.add(channel.name + unit, [...signals, ...bounds], 230);
      const errorOf = (name) =>
        channel[name].map((p, i) => (p == null ? null : p - channel.measured[i]));
      const errors = this.models.map(([name, of]) => [name, of, errorOf(name)]);
      this.add(`error of ${channel.name}${unit}`, errors, 130);
    }
    for (const c of episode.commands) {
      const issued = ["issued", "--pale", c.issued];
      const applied = c.applied ? [["applied", "--corrected", c.applied]] : [];
      const how = c.applied ? `: issued, and applied ${episode.applied}` : "";
      this.add(`command ${c.name} [${c.unit}]${how}`, [issued, ...applied], 90);
    }
    this.range.max = episode.t_s.length - 1;
    const at = Math.min(Number(this.range.value), episode.t_s.length - 1);
    this.show(at);
    // by then the axes have their scales
    requestAnimationFrame(() => this.episode === episode && this.scrub(at));
  }

  add(title, lines, height) {
    const heading = document.createElement("h3");
    heading.textContent = title;
    const place = document.createElement("div");
    place.className = "plot";
    this.plots.append(heading, place);
    const axis = {
      stroke: colour("--pale"),
      grid: { stroke: colour("--line"), width: 1 },
      ticks: { show: false },
      font: "12px system-ui",
    };
    const isPointer = (u) => u.cursor.event && u.cursor.idx != null && u.cursor.left >= 0;
    const options = {
      width: Math.max(this.plots.clientWidth, 240),
      height,
      cursor: {
        y: false,
        sync: { key: "recording", setSeries: false },
        drag: { x: true, y: false },
        points: { size: 5 },
      },
      scales: { x: { time: false } },
      axes: [
        { ...axis, size: 28, values: (_, ticks) => ticks.map((t) => `${+t.toPrecision(6)} s`) },
        { ...axis, size: 58 },
      ],
      series: [
        {},
        ...lines.map(([label, of, , dash]) => ({
          label,
          stroke: colour(of),
          width: 1.4,
          spanGaps: false,
          dash,
        })),
      ],
      hooks: {
        setCursor: [(u) => isPointer(u) && this.show(u.cursor.idx)],
        setScale: [(u, key) => key === "x" && !this.busy && this.zoom(u)],
      },
    };
    const values = [this.episode.t_s, ...lines.map((line) => line[2])];
    this.charts.push(new uPlot(options, values, place));
  }

  zoom(from) {
    const { min, max } = from.scales.x;
    this.busy = true;
    for (const plot of this.charts) if (plot !== from) plot.setScale("x", { min, max });
    this.busy = false;
  }

  scrub(at) {
    const t = this.episode.t_s[at];
    for (const plot of this.charts) {
      plot.setCursor({ left: plot.valToPos(t, "x"), top: 0 }, false);
    }
    this.show(at);
  }

  show(at) {
    const t = this.episode.t_s[at];
    this.range.value = at;
    this.range.setAttribute("aria-valuetext", `${digits(t)} seconds`);
    this.output.textContent = `${digits(t)} s`;
    this.values.replaceChildren(
      ...this.episode.channels.map((c) => {
        const row = document.createElement("tr");
        const last = this.models.at(-1)[0];
        const shown = this.lines.map(([name]) => digits(c[name][at]));
        for (const text of [c.name, ...shown, digits(c[last][at] - c.measured[at])]) {
          const cell = document.createElement("td");
          cell.className = row.children.length ? "n" : "";
          cell.textContent = text;
          row.append(cell);
        }
        return row;
      }),
    );
  }
}

/** Draws the recordings of a page, or signs in with the token that the link holds. */
function look() {
  const data = document.getElementById("figures");
  const root = document.getElementById("recordings");
  if (data && root && !root.dataset.drawn && typeof uPlot !== "undefined") {
    root.dataset.drawn = "yes";
    new Recordings(root, JSON.parse(data.textContent));
  }
  const field = document.getElementById("token");
  if (field && location.hash.startsWith("#token=")) {
    // a fragment never leaves the browser: the token is in no server's log
    field.value = decodeURIComponent(location.hash.slice(7));
    history.replaceState(null, "", location.pathname + location.search);
    field.form.requestSubmit();
  }
}

document.addEventListener("DOMContentLoaded", look);
document.addEventListener("htmx:after:swap", look);
