"use strict";
const root = document.documentElement;
const { charts, times } = JSON.parse(document.getElementById("data").textContent);
const off = new Set();
const drawn = new Set();
let frame = 0;

// Dark and light: the system's choice until the button is used.
const system = matchMedia("(prefers-color-scheme: dark)");
const colour = name => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
function setTheme(dark) {
  root.dataset.theme = dark ? "dark" : "light";
  const button = document.querySelector(".theme");
  button.textContent = dark ? "Light" : "Dark";
  for (const plot of drawn) draw(plot);
}
system.addEventListener("change", () => setTheme(system.matches));
document.querySelector(".theme").addEventListener("click", () => setTheme(root.dataset.theme !== "dark"));

// Charts: drawn when they come near the screen.
function painted(value) {
  if (value === "ink" || value === "soft") return colour(value);
  if (Array.isArray(value)) return typeof value[0] === "object" && value[0] ? value.map(painted) : value;
  if (value && typeof value === "object") {
    return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, painted(inner)]));
  }
  return value;
}
function axis(own) {
  const title = { ...own.title, standoff: 6, font: { size: 12 } };
  return { gridcolor: colour("line"), zerolinecolor: colour("line"), linecolor: colour("line"), automargin: true,
           ...own, title };
}
function layoutOf(spec, width) {
  const layout = painted(spec.layout);
  for (const key of Object.keys(layout)) if (/^[xy]axis/.test(key)) layout[key] = axis(layout[key]);
  if (layout.scene) {
    for (const key of ["xaxis", "yaxis", "zaxis"]) {
      layout.scene[key] = { ...axis(layout.scene[key]), backgroundcolor: "rgba(0,0,0,0)" };
    }
  }
  const narrow = width < 600;
  if (spec.time && times.length > 1) {
    const pad = .01 * (times.at(-1) - times[0]);
    layout.xaxis.range = [times[0] - pad, times.at(-1) + pad];
  }
  return { ...layout, width: width || undefined, height: narrow && !layout.scene ? Math.round(.9 * spec.height) : spec.height, showlegend: false,
           paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", hovermode: "closest",
           font: { color: colour("ink"), size: narrow ? 11 : 12, family: "system-ui, sans-serif" },
           dragmode: narrow && !layout.scene ? "pan" : undefined,
           margin: layout.scene ? { l: 0, r: 0, t: 0, b: 0 } : { l: narrow ? 44 : 64, r: 10, t: 8, b: 40 },
           modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("soft"), activecolor: colour("mark") },
           uirevision: "kept" };
}
const hiddenBy = trace => trace.meta && off.has(trace.meta);
function draw(plot) {
  const spec = charts[plot.dataset.chart];
  const data = painted(spec.data).map(trace => ({ ...trace, visible: !hiddenBy(trace) }));
  for (const one of spec.follow ?? []) {
    for (const key of ["x", "y", "z"]) if (one[key]) data[one.trace][key] = [one[key][frame]];
  }
  const options = { displaylogo: false, displayModeBar: plot.clientWidth >= 600 ? "hover" : false,
                    scrollZoom: Boolean(spec.layout.scene),
                    modeBarButtons: spec.layout.scene ? [["resetCameraDefault3d", "toImage"]]
                      : [["zoom2d", "pan2d", "resetScale2d", "toImage"]] };
  return Plotly.react(plot, data, layoutOf(spec, plot.clientWidth), options);
}
// A window that changes, a telephone that is turned, a tab that is opened after that.
const sizes = new ResizeObserver(entries => requestAnimationFrame(() => {
  for (const { target } of entries) {
    if (target.clientWidth && target.clientWidth !== target._fullLayout?.width) draw(target);
  }
}));
async function first(plot) {
  if (drawn.has(plot) || plot.closest("[hidden]")) return;
  drawn.add(plot);
  await draw(plot);
  plot.classList.remove("waiting");
  plot.style.minHeight = "";
  sizes.observe(plot);
  if (!charts[plot.dataset.chart].time) return;
  const cursor = document.createElement("div");
  cursor.className = "cursor";
  plot.parentElement.append(cursor);
  plot.on("plotly_hover", event => setTime(event.points[0].x));
  plot.on("plotly_relayout", moveCursors);
  plot.on("plotly_afterplot", moveCursors);
  moveCursors();
}

// One time for all: the slider, the dashed lines, the markers and the frames.
function moveCursors() {
  for (const plot of drawn) {
    const cursor = plot.parentElement.querySelector(".cursor");
    const x = plot._fullLayout?.xaxis;
    if (!cursor || !x || !times.length) continue;
    const at = x.d2p(times[frame]);
    cursor.hidden = at < 0 || at > x._length;
    cursor.style.left = `${x._offset + at}px`;
    cursor.style.height = `${plot.clientHeight - 40}px`;
  }
}
function setTime(seconds) {
  let near = 0;
  times.forEach((t, k) => { if (Math.abs(t - seconds) < Math.abs(times[near] - seconds)) near = k; });
  setFrame(near);
}
function setFrame(number) {
  frame = Math.max(0, Math.min(times.length - 1, number));
  const bar = document.querySelector(".time");
  if (bar) {
    bar.querySelector("input").value = String(frame);
    bar.querySelector("output").textContent = `frame ${frame}, ${times[frame].toFixed(1)} s`;
  }
  moveCursors();
  for (const plot of drawn) {
    for (const one of charts[plot.dataset.chart].follow ?? []) {
      const place = {};
      for (const key of ["x", "y", "z"]) if (one[key]) place[key] = [[one[key][frame]]];
      Plotly.restyle(plot, place, [one.trace]);
    }
  }
  for (const pictures of document.querySelectorAll(".pictures")) {
    const leaves = [...pictures.querySelectorAll("figure[data-frame]")];
    if (!leaves.length) continue;
    const distance = leaf => Math.abs(Number(leaf.dataset.frame) - frame);
    const near = leaves.reduce((best, leaf) => distance(leaf) < distance(best) ? leaf : best);
    leaves.forEach(leaf => { leaf.hidden = leaf !== near; });
  }
}
const bar = document.querySelector(".time");
if (bar) {
  bar.querySelector("input").addEventListener("input", event => setFrame(Number(event.target.value)));
  for (const button of bar.querySelectorAll("[data-step]")) {
    button.addEventListener("click", () => setFrame(frame + Number(button.dataset.step)));
  }
  setFrame(0);
}

// Estimators on and off, in charts, drawings and tables.
for (const button of document.querySelectorAll("button[data-series]")) {
  button.addEventListener("click", () => {
    const name = button.dataset.series;
    const shown = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(shown));
    shown ? off.delete(name) : off.add(name);
    for (const plot of drawn) {
      const own = charts[plot.dataset.chart].data.flatMap((trace, k) => trace.meta === name ? [k] : []);
      if (own.length) Plotly.restyle(plot, { visible: shown }, own);
    }
    for (const curve of document.querySelectorAll("g[id*='series--']")) {
      if (curve.id.includes(`series--${name}--`)) curve.style.display = shown ? "" : "none";
    }
    for (const row of document.querySelectorAll("tr[data-row]")) {
      if (row.dataset.row === name) row.hidden = !shown;
    }
  });
}
for (const table of document.querySelectorAll("table")) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => heading.querySelector("button").addEventListener("click", () => {
    const descending = heading.getAttribute("aria-sort") === "ascending";
    headings.forEach(other => other.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const key = row => row.cells[column].dataset.key;
    const order = (a, b) => {
      const [x, y] = [key(a), key(b)];
      const numeric = Number(x) - Number(y);
      return Number.isNaN(numeric) ? (x > y) - (x < y) : numeric;
    };
    const rows = [...table.tBodies[0].rows].sort(order);
    if (descending) rows.reverse();
    table.tBodies[0].append(...rows);
  }));
}
for (const choice of document.querySelectorAll(".choice")) {
  const tabs = [...choice.querySelectorAll("[role=tab]")];
  const panels = [...choice.querySelectorAll("[role=tabpanel]")];
  tabs.forEach((tab, chosen) => tab.addEventListener("click", () => {
    tabs.forEach((other, k) => other.setAttribute("aria-selected", String(k === chosen)));
    panels.forEach((panel, k) => { panel.hidden = k !== chosen; });
    panels[chosen].querySelectorAll(".plot").forEach(plot => { if (window.Plotly) first(plot); });
  }));
}

// What a list picks, its chart shows.
for (const list of document.querySelectorAll("select[data-picks]")) {
  list.addEventListener("change", () => {
    const spec = charts[list.dataset.picks];
    spec.picked.forEach((curves, k) => { spec.data[k].y = curves[Number(list.value)]; });
    for (const plot of drawn) if (plot.dataset.chart === list.dataset.picks) draw(plot);
  });
}

// A picture is enlarged by a click.
const dialog = document.querySelector("dialog");
for (const picture of document.querySelectorAll(".pictures button")) {
  picture.addEventListener("click", () => {
    dialog.querySelector("img").src = picture.querySelector("img").src;
    dialog.showModal();
  });
}
dialog.addEventListener("click", () => dialog.close());

setTheme(system.matches);

// Plotly comes compressed; it is unpacked after the page is on the screen.
async function load() {
  const packed = document.getElementById("plotly");
  if (!packed || !Object.keys(charts).length) return;
  const bytes = Uint8Array.from(atob(packed.textContent.trim()), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(stream).text();
  document.head.append(script);
  packed.remove();
  const watch = new IntersectionObserver(entries => {
    for (const entry of entries) if (entry.isIntersecting) first(entry.target);
  }, { rootMargin: "400px" });
  document.querySelectorAll(".plot").forEach(plot => watch.observe(plot));
}
addEventListener("load", () => requestAnimationFrame(() => setTimeout(load)));
