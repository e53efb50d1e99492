/** The behaviour as boxes over time: which columns of the picture hold something, and which are said to. */

import { h } from "../../dom.js";
import { canvas } from "../../parts/charts.js";
import { segments } from "../../parts/elements.js";
import { bands } from "./bands.js";
import { LABELS, rowCount } from "./episode.js";
import { palette } from "./palette.js";

const LEFT_PX = 52;
const RIGHT_PX = 10;
const TOP_PX = 8;
const BOTTOM_PX = 38;
const LABELLED_SHARE = 0.04;
/** Of an episode: shorter bands are not named. */
const MANY = 12;
const KINDS = [["", "Everything"], ["1", "People"], ["0", "Vehicles"]];

/** Return the chart of a player's episode; null if there are no boxes. */
export function boxes(player) {
  const { episode, signal } = player;
  const { told } = episode;
  if (rowCount(told.seen) + rowCount(told.given) === 0) return null;
  const colours = palette();
  const every = { seen: bands(told.seen, episode.times.length), given: bands(told.given, episode.times.length) };
  const present = new Set([...every.seen, ...every.given].map(({ label }) => label));
  let { seen, given, crowded } = chosen("");
  const wide_px = episode.camera.width_px;
  const cursor = h("i.time-cursor", { "aria-hidden": "true" });
  let area = null;
  let named = [];

  const sheet = canvas({
    label: `Boxes in the picture over time: what is there, and what is ${episode.report}`, ratio: 4, least: 220, most: 320, signal,
    recolour: colours.renew, draw,
  });
  const kinds = present.size < 2 ? null : segments("Boxes of", choose, KINDS, "");
  if (kinds && crowded) choose(toldOf());
  sheet.append(cursor);
  sheet.classList.add("seekable");

  /** What a crowded chart shows at first: what the injected boxes are of; for a detector, people. */
  function toldOf() {
    if (episode.report !== "injected") return "1";
    const labels = new Set(every.given.map(({ label }) => label));
    return labels.size === 1 ? String([...labels][0]) : "";
  }

  function chosen(label) {
    const of = (all) => (label === "" ? all : all.filter((band) => band.label === Number(label)));
    const [there, said] = [of(every.seen), of(every.given)];
    return { seen: there, given: said, crowded: there.length + said.length > MANY };
  }

  function choose(label) {
    ({ seen, given, crowded } = chosen(label));
    kinds.update(KINDS, label);
    sheet.redraw();
  }

  function x(time_s) {
    return area.left + ((time_s - episode.start_s) / Math.max(1e-6, episode.end_s - episode.start_s)) * area.width;
  }

  function draw(pen, width, height) {
    area = { left: LEFT_PX, top: TOP_PX, width: width - LEFT_PX - RIGHT_PX, height: height - TOP_PX - BOTTOM_PX };
    pen.clearRect(0, 0, width, height);
    drawAxes(pen, width, height);
    pen.save();
    pen.beginPath();
    pen.rect(area.left, area.top, area.width, area.height);
    pen.clip();
    for (const band of seen) drawBand(pen, band, false);
    for (const band of given) drawBand(pen, band, true);
    named = [];
    for (const band of [...given].sort((a, b) => b.label - a.label || b.samples.length - a.samples.length)) name(pen, band);
    pen.restore();
    place();
  }

  function y(column_px) {
    return area.top + area.height * (1 - column_px / wide_px);
  }

  function drawAxes(pen, width, height) {
    pen.strokeStyle = colours.line;
    pen.fillStyle = colours.muted;
    pen.lineWidth = 1;
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let column = 0; column <= wide_px; column += wide_px / 4) {
      line(pen, area.left, y(column), area.left + area.width, y(column));
      pen.fillText(String(Math.round(column)), area.left - 6, y(column));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const step_s = [0.2, 0.5, 1, 2, 5, 10, 30, 60, 300].find((step) => (x(step) - x(0)) >= 44) ?? 600;
    for (let time_s = Math.ceil(episode.start_s / step_s) * step_s; time_s <= episode.end_s + 1e-6; time_s += step_s) {
      line(pen, x(time_s), area.top, x(time_s), area.top + area.height);
      pen.fillText(String(Number(time_s.toFixed(1))), x(time_s), area.top + area.height + 4);
    }
    pen.fillText("time, s", area.left + area.width / 2, height - 16);
    pen.save();
    pen.translate(8, area.top + area.height / 2);
    pen.rotate(-Math.PI / 2);
    pen.textBaseline = "middle";
    pen.fillText("column, px", 0, 0);
    pen.restore();
  }

  function drawBand(pen, { label, samples, low, high }, said) {
    const times = [...samples, Math.min(episode.last, samples.at(-1) + 1)].map((sample) => episode.times[sample]);
    const [under, over] = [[...low, low.at(-1)], [...high, high.at(-1)]];
    pen.beginPath();
    times.forEach((time_s, index) => (index ? pen.lineTo(x(time_s), y(over[index])) : pen.moveTo(x(time_s), y(over[index]))));
    for (let index = times.length - 1; index >= 0; index -= 1) pen.lineTo(x(times[index]), y(under[index]));
    pen.closePath();
    const person = label === 1;
    pen.fillStyle = said ? colours.injected : person ? colours.pedestrian : colours.vehicle;
    pen.globalAlpha = (said ? 0.12 : 0.32) / (crowded ? 2 : 1);
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = said ? colours.injected : colours.seen;
    pen.lineWidth = said && !crowded ? 2 : 1;
    if (said) pen.setLineDash([6, 4]);
    pen.stroke();
    pen.setLineDash([]);
  }

  /** Name a band at its beginning, unless it is short or another name is there: people and long ones come first. */
  function name(pen, { label, samples, low, high }) {
    if (samples.length < Math.max(4, LABELLED_SHARE * episode.last)) return;
    const word = LABELS[label] ?? "obstacle";
    pen.font = "600 12px system-ui, sans-serif";
    const wide = pen.measureText(word).width;
    const left = Math.min(x(episode.times[samples[0]]) + 5, area.left + area.width - wide - 4);
    const middle = y((low[0] + high[0]) / 2);
    if (named.some((other) => left < other.left + other.wide + 6 && other.left < left + wide + 6 && Math.abs(other.middle - middle) < 15)) return;
    named.push({ left, wide, middle });
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    pen.strokeStyle = colours.paper;
    pen.lineWidth = 3;
    pen.strokeText(word, left, middle);
    pen.fillStyle = colours.injected;
    pen.fillText(word, left, middle);
  }

  function place() {
    if (!area) return;
    cursor.style.left = `${x(player.time_s)}px`;
    cursor.style.top = `${area.top}px`;
    cursor.style.height = `${area.height}px`;
  }

  function seek(event) {
    if (!area || (event.type === "pointermove" && !(event.buttons & 1))) return;
    const left = event.clientX - sheet.getBoundingClientRect().left;
    player.seek(episode.start_s + ((left - area.left) / area.width) * (episode.end_s - episode.start_s));
  }

  sheet.addEventListener("pointerdown", seek);
  sheet.addEventListener("pointermove", seek);
  player.listen((_, changed) => changed.time && place());

  return h("section.card", { "aria-label": "Boxes over time" },
    h("div.inline", null, h("h2", null, "Boxes in the picture over time"), kinds), sheet,
    h("ul.legend", null, every.seen.some(({ label }) => label !== 1) && h("li", null, h("i.key.band.vehicle"), "a vehicle is there"),
      every.seen.some(({ label }) => label === 1) && h("li", null, h("i.key.band.pedestrian"), "a person is there"),
      rowCount(told.given) > 0 && h("li", null, h("i.key.given.dashed"), `${episode.report}: what the driving system is told`)),
    h("p.hint", null, "Up is from the left edge of the picture to its right one. Click to go to a time."));
}

function line(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
}
