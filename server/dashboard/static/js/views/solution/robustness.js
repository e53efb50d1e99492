/** Robustness over time, a line a requirement: below zero it is violated. */

import { h, text } from "../../dom.js";
import { figure, plainId, spaced } from "../../format.js";
import { colour } from "../../theme.js";
import { chart } from "../../parts/charts.js";

const EDGE = 5;
/** Values beyond this are drawn at the edge: what matters is near zero. */
const SERIES = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5", "--series-6"];
const DASHES = [undefined, [8, 4], [2, 3], [10, 3, 2, 3]];

/** Return the chart of a player's episode; null if no requirement is recorded. */
export function robustness(player) {
  const { episode, signal } = player;
  const { robustness: recorded, units } = episode.told;
  const told = episode.story?.requirement;
  const names = Object.keys(recorded).sort((a, b) => (b === told) - (a === told));
  if (names.length === 0) return null;
  const near = names.filter((name, index) => index === 0 || recorded[name].some((value) => value !== null && value < EDGE));
  const far = names.filter((name) => !near.includes(name));
  const least = Math.min(0, ...near.map((name) => recorded[name].reduce((low, value) => (value === null ? low : Math.min(low, value)), 0)));
  const floor = Math.max(-EDGE, Math.min(-1, 1.1 * least));
  const cursor = h("i.time-cursor", { "aria-hidden": "true" });
  const clipped = (value) => (value === null ? null : Math.max(floor, Math.min(EDGE, value)));

  const node = chart({
    label: "Robustness of each requirement over time", x: "time, s", signal, height: 260,
    series: near.map((name, index) => ({
      label: named(name, units[name]), colour: SERIES[index % SERIES.length], width: name === told ? 2.5 : 1.5,
      dash: DASHES[Math.floor(index / SERIES.length) % DASHES.length] ?? (index ? DASHES[index % DASHES.length] : undefined),
      more: { value: (_, __, ___, at) => (at === null || at === undefined ? "–" : figure(recorded[name][at])) },
    })),
    options: {
      scales: { x: { time: false }, y: { range: [floor, EDGE] } },
      axes: [{}, { label: "robustness" }],
      cursor: { drag: { x: false, y: false }, y: false },
      hooks: {
        drawClear: [(plot) => {
          const { ctx, bbox } = plot;
          const zero = plot.valToPos(0, "y", true);
          ctx.save();
          ctx.fillStyle = colour("--bad-ground");
          ctx.fillRect(bbox.left, zero, bbox.width, bbox.top + bbox.height - zero);
          ctx.fillStyle = colour("--bad");
          ctx.fillRect(bbox.left, zero - 1, bbox.width, 2);
          ctx.restore();
        }],
        ready: [(plot) => {
          plot.over.append(cursor);
          plot.over.addEventListener("pointerdown", (event) => seek(plot, event));
          plot.over.addEventListener("pointermove", (event) => event.buttons & 1 && seek(plot, event));
          plot.over.addEventListener("pointerleave", () => follow(plot));
          follow(plot);
        }],
        setSize: [(plot) => requestAnimationFrame(() => follow(plot))],
      },
    },
  });
  node.classList.add("seekable");

  function seek(plot, event) {
    player.seek(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
  }

  /** Put the cursor where the time is, and its values into the legend, unless somebody points at others. */
  function follow(plot, values = true) {
    if (!plot || signal.aborted) return;
    cursor.style.left = `${plot.valToPos(player.time_s, "x")}px`;
    if (values && !plot.over.matches(":hover")) plot.setLegend({ idx: player.sample });
  }

  player.listen((_, changed) => changed.time && follow(node.plot, changed.sample));
  node.update([episode.times, ...near.map((name) => recorded[name].map(clipped))]);
  const note = h("p.hint");
  text(note, [
    "The distance to violation, each in its unit; below zero the requirement is violated.",
    `What is farther than ${EDGE} from zero is drawn at the edge.`,
    far.length > 0 && `Never nearer than that: ${far.map((name) => spaced(plainId(name))).join(", ")}.`,
    "Click to go to a time.",
  ].filter(Boolean).join(" "));
  return h("section.card", { "aria-label": "Robustness over time" }, h("h2", null, "Robustness over time"), node, note);
}

function named(requirement, unit) {
  return unit ? `${spaced(plainId(requirement))}, ${unit}` : spaced(plainId(requirement));
}
