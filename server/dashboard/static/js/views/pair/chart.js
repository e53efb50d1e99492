/** Both drives of a pair over time: what was reported, plans, and the margin of the requirement, on one time axis. */

import { h } from "../../dom.js";
import { plainId, spaced } from "../../format.js";
import { colour } from "../../theme.js";
import { canvas } from "../../parts/charts.js";
import { drawLine, FONT, key, palette } from "../solution/drawing.js";
import { eachRow } from "../solution/episode.js";

const [LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX] = [76, 12, 6, 38];
const [LANE_PX, GAP_PX, NAME_PX, MARGIN_PX] = [13, 8, 16, 170];
const NARROW_PX = 60;
/** A plan's band that is narrower has no name. */
const EDGE = 12;
/** A larger margin is drawn at the edge: beyond it there is no danger. */
const SAME_PX = 0.5;
/** Boxes whose sides are this close are the same. */
const SIDES = [["safe", "--safe"], ["unsafe", "--unsafe"]];

/**
 * Return the chart of a pair.
 *
 * @param {import("../solution/episode.js").Player} player Whose time is shown and set.
 * @param {import("../solution/episode.js").Episode[]} episodes The safe and the unsafe drive.
 * @param {{start_s: number, end_s: number}[]} differing When their reports differ.
 */
export function overTime(player, episodes, differing) {
  const groups = bands(episodes);
  const colours = palette();
  const story = episodes[1].story;
  const requirement = story?.requirement;
  const unit = requirement ? episodes[1].data.units[requirement] : "";
  const lanes_px = groups.length * (NAME_PX + 2 * LANE_PX + GAP_PX);
  const height_px = TOP_PX + lanes_px + (requirement ? MARGIN_PX : 0) + BOTTOM_PX;
  const { start_s, end_s } = player.episode;
  const cursor = h("i.time-cursor", { "aria-hidden": "true" });
  let width_px = 0;
  const sheet = canvas({
    label: `Both drives over time: ${groups.map(({ name }) => name).join(", ")}${requirement ? `, ${spaced(plainId(requirement))} margin` : ""}`,
    ratio: 1, least: height_px, most: height_px, signal: player.signal, recolour: colours.renew, draw,
  });
  sheet.append(cursor);
  sheet.classList.add("seekable");

  function x(time_s) {
    return LEFT_PX + ((time_s - start_s) / Math.max(1e-6, end_s - start_s)) * (width_px - LEFT_PX - RIGHT_PX);
  }

  function draw(pen, width, height) {
    width_px = width;
    pen.clearRect(0, 0, width, height);
    pen.fillStyle = colour("--warn-ground");
    for (const span of differing) pen.fillRect(x(span.start_s), TOP_PX, x(span.end_s) - x(span.start_s), height - TOP_PX - BOTTOM_PX);
    drawTimes(pen, height);
    groups.forEach((group, index) => drawGroup(pen, group, TOP_PX + index * (NAME_PX + 2 * LANE_PX + GAP_PX)));
    if (requirement) drawMargin(pen, TOP_PX + lanes_px, MARGIN_PX);
    placeCursor();
  }

  function drawTimes(pen, height) {
    pen.font = FONT;
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const step_s = [1, 2, 5, 10, 30, 60, 300].find((step) => x(step) - x(0) >= 40) ?? 600;
    for (let time_s = Math.ceil(start_s / step_s) * step_s; time_s <= end_s + 1e-6; time_s += step_s) {
      pen.strokeStyle = colours.line;
      pen.lineWidth = 1;
      drawLine(pen, x(time_s), TOP_PX, x(time_s), height - BOTTOM_PX);
      pen.fillStyle = colours.muted;
      pen.fillText(String(time_s), x(time_s), height - BOTTOM_PX + 4);
    }
    pen.fillText("time, s", (LEFT_PX + width_px) / 2, height - 16);
    if (!story?.violated) return;
    const at = x(story.violations[0].time_s);
    pen.strokeStyle = colours.violation;
    pen.setLineDash([4, 3]);
    drawLine(pen, at, TOP_PX, at, height - BOTTOM_PX);
    pen.setLineDash([]);
  }

  function drawGroup(pen, { name, lanes, named }, top) {
    pen.font = FONT;
    pen.textBaseline = "middle";
    pen.textAlign = "left";
    pen.fillStyle = colours.ink;
    pen.fillText(name, 0, top + NAME_PX / 2);
    SIDES.forEach(([side, fill], lane) => {
      const y = top + NAME_PX + lane * LANE_PX;
      pen.fillStyle = colours.muted;
      pen.textAlign = "right";
      pen.fillText(side, LEFT_PX - 6, y + LANE_PX / 2);
      const episode = episodes[lane];
      pen.fillStyle = colours.line;
      pen.globalAlpha = 0.45;
      pen.fillRect(x(episode.start_s), y, x(episode.end_s) - x(episode.start_s), LANE_PX - 1);
      pen.globalAlpha = 1;
      for (const { word, first, last } of lanes[lane]) {
        const [from, to] = [x(episode.times[first]), x(episode.times[Math.min(episode.last, last + 1)])];
        pen.fillStyle = colour(fill);
        pen.globalAlpha = named ? (word === "cruise" ? 0.12 : 0.34) : 1;
        pen.fillRect(from, y, Math.max(2, to - from), LANE_PX - 1);
        pen.globalAlpha = 1;
        if (!named || to - from < NARROW_PX) continue;
        pen.fillStyle = colours.ink;
        pen.textAlign = "center";
        pen.fillText(word, (from + to) / 2, y + LANE_PX / 2);
      }
    });
  }

  function drawMargin(pen, top, high) {
    const series = episodes.map(({ data }) => data.robustness[requirement] ?? []);
    const values = series.flat().filter((value) => value !== null);
    const most = Math.max(1, Math.min(EDGE, values.reduce((a, b) => Math.max(a, b), 0)));
    const least = Math.min(-1, values.reduce((a, b) => Math.min(a, b), 0) * 1.2);
    const y = (value) => top + NAME_PX + LANE_PX + (high - NAME_PX - LANE_PX) * (1 - (Math.min(most, value) - least) / (most - least));
    pen.fillStyle = colour("--bad-ground");
    pen.fillRect(LEFT_PX, y(0), width_px - LEFT_PX - RIGHT_PX, top + high - y(0));
    pen.fillStyle = colours.ink;
    pen.font = FONT;
    pen.textBaseline = "middle";
    pen.textAlign = "left";
    pen.fillText(`${spaced(plainId(requirement)).replaceAll("-", " ")} margin${unit ? `, ${unit}` : ""}`, 0, top + NAME_PX / 2);
    pen.textAlign = "right";
    for (const value of [0, most]) {
      pen.strokeStyle = value === 0 ? colours.violation : colours.line;
      pen.lineWidth = 1;
      drawLine(pen, LEFT_PX, y(value), width_px - RIGHT_PX, y(value));
      pen.fillStyle = colours.muted;
      pen.fillText(value === 0 ? "0" : `${Math.round(value)}${value === EDGE ? "+" : ""}`, LEFT_PX - 6, y(value));
    }
    series.forEach((line, index) => {
      pen.strokeStyle = colour(SIDES[index][1]);
      pen.lineWidth = 2;
      if (index === 0) pen.setLineDash([7, 4]);
      pen.beginPath();
      let drawing = false;
      line.forEach((value, sample) => {
        if (value === null) return;
        const at = x(episodes[index].times[sample]);
        if (drawing) pen.lineTo(at, y(value));
        else pen.moveTo(at, y(value));
        drawing = true;
      });
      pen.stroke();
      pen.setLineDash([]);
    });
  }

  function placeCursor() {
    if (!width_px) return;
    cursor.style.left = `${x(player.time_s)}px`;
    cursor.style.top = `${TOP_PX}px`;
    cursor.style.height = `${height_px - TOP_PX - BOTTOM_PX}px`;
  }

  function seek(event) {
    if (!width_px || (event.type === "pointermove" && !(event.buttons & 1))) return;
    const left = event.clientX - sheet.getBoundingClientRect().left;
    player.seek(start_s + ((left - LEFT_PX) / (width_px - LEFT_PX - RIGHT_PX)) * (end_s - start_s));
  }

  sheet.addEventListener("pointerdown", seek);
  sheet.addEventListener("pointermove", seek);
  player.listen((_, changed) => changed.time && placeCursor());
  return h("section.card", { "aria-label": "Both drives over time" }, h("h2", null, "Both drives over time"), sheet,
    h("ul.legend", null, key("ego line", "safe drive (margin dashed)"), key("unsafe-line line", "unsafe drive"), differing.length > 0 && key("differing", "reports differ")),
    h("p.hint", null, "The dashed vertical line is the unsafe drive's violation. Click to jump to a time."));
}

/** Return when the driving systems of two drives receive different boxes, up to the end of the shorter drive. */
export function differingSpans(safe, unsafe) {
  const shorter = safe.last <= unsafe.last ? safe : unsafe;
  const differ = shorter.times.map((time_s) => {
    const [one, other] = [safe, unsafe].map((episode) => boxesAt(episode, time_s));
    return one.length !== other.length || one.some((value, place) => Math.abs(value - other[place]) > SAME_PX) ? "differ" : "";
  });
  return runs(differ).map(({ first, last }) => ({ start_s: shorter.times[first], end_s: shorter.times[Math.min(shorter.last, last + 1)] }));
}

function boxesAt(episode, time_s) {
  const rows = [];
  eachRow(episode.data.given, episode.sampleAt(time_s + 1e-3), (row, columns) => {
    rows.push(["label", "x_min_px", "x_max_px", "y_min_px", "y_max_px"].map((name) => columns[name][row]));
  });
  return rows.sort((a, b) => a.reduce((found, value, place) => found || value - b[place], 0)).flat();
}

/** Return groups of two lanes: reported boxes by label, and plans. */
function bands(episodes) {
  const labels = [...new Set(episodes.flatMap(({ data }) => data.given.columns.label))].sort();
  const groups = labels.map((label) => ({
    name: `${episodes[1].words.report} ${episodes[1].byLabel("labels", label)}`, named: false,
    lanes: episodes.map((episode) => runs(episode.times.map((_, sample) => {
      let here = "";
      eachRow(episode.data.given, sample, (row, columns) => { if (columns.label[row] === label) here = "reported"; });
      return here;
    }))),
  }));
  return [...groups, { name: "plan", named: true, lanes: episodes.map(({ data }) => runs(data.plan_mode)) }];
}

/** Return each run of equal words as word, first and last sample; runs of empty words are left out. */
function runs(words) {
  const found = [];
  words.forEach((word, sample) => {
    const last = found.at(-1);
    if (last && last.word === word) last.last = sample;
    else found.push({ word, first: sample, last: sample });
  });
  return found.filter(({ word }) => word);
}
