/**
 * A canvas for some twenty thousand points on their ground: drag to pan, wheel or pinch to zoom, a lasso to select, a
 * click to open. All points are painted again for each frame, pixel by pixel, which is several times as fast as canvas
 * paths.
 */

import { h } from "../../dom.js";
import { colour, onTheme } from "../../theme.js";

const MARGIN = 24;
const NEAR_PX = 14;
const MOST_ZOOM = 60;
const SOLID = 0.8;
const FAINT = 0.22;
const RING_PX = 10;
const MOST_NUMBERED = 30; // more would hide the points

/**
 * @typedef {object} Ring
 * @property {number[]} at Indices of the points that it marks: one, or the two sides of a pair.
 * @property {number} place Its number.
 */

/**
 * Return a map.
 *
 * @param {object} given
 * @param {AbortSignal} given.signal
 * @param {(index: number|null, event: {x: number, y: number}) => void} given.hover The point under the pointer.
 * @param {(index: number) => void} given.open A point was clicked.
 * @param {(ring: Ring|null, event: {x: number, y: number}) => void} given.hoverRing The numbered ring under the pointer.
 * @param {(ring: Ring) => void} given.openRing A numbered ring was clicked.
 * @param {(indices: number[]) => void} given.choose A lasso was closed.
 * @returns {HTMLCanvasElement} With ``show``, ``select``, ``zoom``, ``whole``, ``lasso`` and, for measurements, ``frames``.
 */
export function solutionMap({ signal, hover, open, hoverRing, openRing, choose }) {
  const canvas = h("canvas.map", {
    tabindex: 0, role: "application",
    "aria-label": "Map of the solutions. Arrow keys pan, plus and minus zoom, 0 shows all. The table of boundary solutions has the same content as text.",
  });
  const pen = canvas.getContext("2d", { willReadFrequently: true }); // keeps the canvas in main memory, where it is painted
  let width = 0;
  let height = 0;
  let ratio = 1;
  let data = null;
  let colouring = null;
  let picture = null;
  let pixels = null;
  let bounds = { x: 0, y: 0, scale: 1 };
  let view = { zoom: 1, dx: 0, dy: 0 };
  let chosen = new Set();
  let ringed = []; // the results of the search, best first
  let ground = null;
  let ring = null; // the open solution
  let lassoing = false;
  let path = null;
  let due = false;
  canvas.frames = [];

  const scale = () => bounds.scale * view.zoom;
  const toX = (x) => width / 2 + (x - bounds.x) * scale() + view.dx;
  const toY = (y) => height / 2 - (y - bounds.y) * scale() + view.dy;

  function resize() {
    ratio = Math.min(devicePixelRatio || 1, 2);
    width = canvas.clientWidth;
    height = canvas.clientHeight;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    fit();
    draw();
  }

  function fit() {
    if (!data || !data.count || !width) return;
    let [left, right, bottom, top] = [Infinity, -Infinity, Infinity, -Infinity];
    for (let i = 0; i < data.count; i += 1) {
      left = Math.min(left, data.x[i]);
      right = Math.max(right, data.x[i]);
      bottom = Math.min(bottom, data.y[i]);
      top = Math.max(top, data.y[i]);
    }
    bounds = {
      x: (left + right) / 2, y: (bottom + top) / 2,
      scale: Math.min((width - 2 * MARGIN) / Math.max(right - left, 1e-6), (height - 2 * MARGIN) / Math.max(top - bottom, 1e-6)),
    };
  }

  function radius() {
    const base = Math.max(1.6, Math.min(5, 110 / Math.sqrt(data.count + 1)));
    return base * Math.min(2.2, Math.sqrt(Math.sqrt(view.zoom)));
  }

  function draw() {
    if (due) return;
    due = true;
    requestAnimationFrame(() => {
      due = false;
      const began = performance.now();
      paint();
      canvas.frames.push([began, performance.now() - began]);
      if (canvas.frames.length > 600) canvas.frames.shift();
    });
  }

  function paint() {
    if (!canvas.width || !canvas.height) return;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = colour("--sunk");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    const ready = data?.count && colouring;
    if (ready) {
      if (data.ground) drawGround();
      picture = pen.getImageData(0, 0, canvas.width, canvas.height);
      pixels = new Uint32Array(picture.data.buffer);
      stampAll();
      pen.putImageData(picture, 0, 0);
    }
    if (!ready) return;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    rings();
    drawPath();
  }

  /** Hatch what is unknown, and draw the ground over it, which is as transparent as it is unknown. */
  function drawGround() {
    if (ground?.of !== data.ground) ground = groundOf(data.ground);
    pen.fillStyle = pen.createPattern(ground.hatching, "repeat");
    pen.fillRect(0, 0, canvas.width, canvas.height);
    const { left, bottom, right, top, columns, rows } = data.ground;
    const [wide, tall] = [(right - left) / (columns - 1), (top - bottom) / (rows - 1)]; // of a cell, whose value is in its middle
    const [x, y] = [toX(left - wide / 2), toY(top + tall / 2)];
    pen.drawImage(ground.tinted, x * ratio, y * ratio, columns * wide * scale() * ratio, rows * tall * scale() * ratio);
  }

  function stampAll() {
    const { width: w, height: tall } = picture;
    const [k, x0, y0] = [scale() * ratio, toX(0) * ratio, toY(0) * ratio];
    const colours = colouring.colours.map(packed);
    const stamp = new Stamp(radius() * ratio, w, chosen.size ? FAINT : SOLID);
    const hollow = new Stamp(radius() * ratio, w, chosen.size ? FAINT : 1, 1.5 * ratio);
    const one = (i, with_) => {
      const x = Math.round(x0 + data.x[i] * k);
      const y = Math.round(y0 - data.y[i] * k);
      const { reach } = with_;
      if (x >= reach && y >= reach && x < w - reach && y < tall - reach) with_.onto(pixels, y * w + x, colours[colouring.index[i]]);
    };
    for (let i = 0; i < data.count; i += 1) one(i, i < data.told ? stamp : hollow);
    if (!chosen.size) return;
    const solid = new Stamp(radius() * ratio, w, 1);
    for (const i of chosen) one(i, solid);
  }

  function isNumbered() {
    return ringed.length <= MOST_NUMBERED;
  }

  function middle({ at }) {
    const mean = (values) => at.reduce((sum, i) => sum + values[i], 0) / at.length;
    return [toX(mean(data.x)), toY(mean(data.y))];
  }

  function rings() {
    pen.font = `700 ${RING_PX + 1}px system-ui, "DejaVu Sans", sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.strokeStyle = colour("--edge");
    const paper = colour("--card");
    for (const one of [...ringed].reverse()) { // where rings overlap, the best is on top
      const [x, y] = middle(one);
      pen.lineWidth = 1.6;
      if (!isNumbered()) {
        circle(x, y, radius() + 3);
        continue;
      }
      pen.fillStyle = paper;
      circle(x, y, RING_PX);
      pen.fill();
      pen.fillStyle = pen.strokeStyle;
      pen.fillText(String(one.place), x, y + 0.5);
    }
    if (ring !== null) {
      pen.lineWidth = 3;
      circle(toX(data.x[ring]), toY(data.y[ring]), radius() + 7);
    }
  }

  function circle(x, y, size) {
    pen.beginPath();
    pen.arc(x, y, size, 0, 7);
    pen.stroke();
  }

  function drawPath() {
    if (!path) return;
    pen.beginPath();
    path.forEach(([x, y], place) => (place ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
    pen.strokeStyle = colour("--accent");
    pen.lineWidth = 1.5;
    pen.setLineDash([5, 4]);
    pen.stroke();
    pen.setLineDash([]);
  }

  function nearest(x, y) {
    if (!data) return null;
    let [best, least] = [null, NEAR_PX ** 2];
    const [k, x0, y0] = [scale(), toX(0), toY(0)];
    for (let i = 0; i < data.count; i += 1) {
      const away = (x0 + data.x[i] * k - x) ** 2 + (y0 - data.y[i] * k - y) ** 2;
      if (away < least) [best, least] = [i, away];
    }
    return best;
  }

  /** Return the numbered ring at a place, the best one first; null if there is none. */
  function ringAt(x, y) {
    if (!data || !isNumbered()) return null;
    return ringed.find((one) => {
      const [middleX, middleY] = middle(one);
      return Math.hypot(middleX - x, middleY - y) <= RING_PX + 1;
    }) ?? null;
  }

  function zoomAt(x, y, factor) {
    const zoom = Math.max(0.5, Math.min(MOST_ZOOM, view.zoom * factor));
    const real = zoom / view.zoom;
    view = { zoom, dx: x - width / 2 - (x - width / 2 - view.dx) * real, dy: y - height / 2 - (y - height / 2 - view.dy) * real };
    draw();
  }

  function inside() {
    const found = [];
    for (let i = 0; i < (data?.count ?? 0); i += 1) if (within(toX(data.x[i]), toY(data.y[i]))) found.push(i);
    return found;
  }

  function within(x, y) {
    let odd = false;
    for (let a = 0, b = path.length - 1; a < path.length; b = a, a += 1) {
      const [[ax, ay], [bx, by]] = [path[a], path[b]];
      if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) odd = !odd;
    }
    return odd;
  }

  // One pointer pans the map or draws the lasso, two zoom.
  const down = new Map();
  let moved = 0;
  const at = (event) => [event.offsetX, event.offsetY];

  const listen = (name, listener, options) => canvas.addEventListener(name, listener, { signal, ...options });
  listen("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, at(event));
    moved = 0;
    if (lassoing || event.shiftKey) path = [at(event)];
  });
  listen("pointermove", (event) => {
    const before = down.get(event.pointerId);
    const now = at(event);
    if (!before) {
      const under = ringAt(...now);
      if (under) hoverRing(under, { x: now[0], y: now[1] });
      else hover(nearest(...now), { x: now[0], y: now[1] });
      return;
    }
    moved += Math.abs(now[0] - before[0]) + Math.abs(now[1] - before[1]);
    if (down.size === 2) {
      const other = [...down].find(([id]) => id !== event.pointerId)[1];
      const [was, is] = [before, now].map(([x, y]) => Math.hypot(x - other[0], y - other[1]));
      if (was > 0) zoomAt((now[0] + other[0]) / 2, (now[1] + other[1]) / 2, is / was);
    } else if (path) {
      path.push(now);
      draw();
    } else {
      view = { ...view, dx: view.dx + now[0] - before[0], dy: view.dy + now[1] - before[1] };
      hover(null, { x: 0, y: 0 });
      draw();
    }
    down.set(event.pointerId, now);
  });
  listen("pointerup", (event) => {
    if (!down.has(event.pointerId)) return;
    down.delete(event.pointerId);
    if (path && moved > 8) {
      choose(inside());
    } else if (moved <= 4 && data) {
      const [under, found] = [ringAt(...at(event)), nearest(...at(event))];
      if (under) openRing(under);
      else if (found === null) choose([]);
      else open(found);
    }
    path = null;
    draw();
  });
  listen("pointercancel", (event) => {
    down.delete(event.pointerId);
    path = null;
    draw();
  });
  listen("pointerleave", () => hover(null, { x: 0, y: 0 }));
  listen("wheel", (event) => {
    // Only when the map has the focus: scrolling past it must not zoom.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoomAt(...at(event), Math.exp(-event.deltaY * 0.002));
  }, { passive: false });
  listen("keydown", (event) => {
    const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] };
    if (moves[event.key]) view = { ...view, dx: view.dx + moves[event.key][0], dy: view.dy + moves[event.key][1] };
    else if (event.key === "+" || event.key === "=") zoomAt(width / 2, height / 2, 1.4);
    else if (event.key === "-") zoomAt(width / 2, height / 2, 1 / 1.4);
    else if (event.key === "0") view = { zoom: 1, dx: 0, dy: 0 };
    else if (event.key === "Escape") choose([]);
    else return;
    event.preventDefault();
    draw();
  });

  canvas.show = (next, colours, { anew = false } = {}) => {
    const first = data === null || anew;
    data = next;
    colouring = colours;
    const place = new Map();
    for (let i = 0; i < data.count; i += 1) place.set(data.number[i], i);
    data.place = place;
    if (first) fit();
    canvas.dataset.points = data.count;
    draw();
  };
  canvas.select = ({ indices, rings: marked, opened }) => {
    chosen = new Set(indices);
    ringed = marked;
    ring = opened;
    draw();
  };
  canvas.zoom = (factor) => zoomAt(width / 2, height / 2, factor);
  canvas.whole = () => {
    view = { zoom: 1, dx: 0, dy: 0 };
    fit();
    draw();
  };
  canvas.lasso = (on) => {
    lassoing = on;
    canvas.classList.toggle("lassoing", on);
  };

  const seen = new ResizeObserver(resize);
  seen.observe(canvas);
  signal.addEventListener("abort", () => seen.disconnect(), { once: true });
  onTheme(() => {
    ground = null;
    draw();
  }, signal);
  return canvas;
}

const HATCH_PX = 9;

/** Return the ground in the colours of the theme: its cells as an image, and a tile of the hatching where it is unknown. */
function groundOf(of) {
  const { columns, rows, tint, clarity } = of;
  const ramp = ["--ground-safe", "--ground-edge", "--ground-unsafe"].map((name) => channels(colour(name)));
  const tinted = new OffscreenCanvas(columns, rows);
  const cells = new ImageData(columns, rows);
  for (let row = 0; row < rows; row += 1) {
    for (let column = 0; column < columns; column += 1) {
      const from = (rows - 1 - row) * columns + column; // rows go up
      const to = 4 * (row * columns + column);
      const place = (2 * tint[from]) / 255;
      const below = Math.min(1, Math.floor(place));
      for (let channel = 0; channel < 3; channel += 1) {
        const start = ramp[below][channel];
        cells.data[to + channel] = start + (ramp[below + 1][channel] - start) * (place - below);
      }
      cells.data[to + 3] = clarity[from];
    }
  }
  tinted.getContext("2d").putImageData(cells, 0, 0);
  const hatching = new OffscreenCanvas(HATCH_PX, HATCH_PX);
  const pen = hatching.getContext("2d");
  pen.fillStyle = colour("--sunk");
  pen.fillRect(0, 0, HATCH_PX, HATCH_PX);
  pen.strokeStyle = colour("--hatch");
  for (const shift of [-HATCH_PX, 0, HATCH_PX]) {
    pen.moveTo(shift - 1, HATCH_PX + 1);
    pen.lineTo(shift + HATCH_PX + 1, -1);
  }
  pen.stroke();
  return { of, tinted, hatching };
}

/** Return red, green and blue of a colour such as ``rgb(1, 2, 3)`` or ``#0a0b0c``. */
function channels(written) {
  const hex = /^#([0-9a-f]{6})$/i.exec(written);
  return hex ? [0, 2, 4].map((at) => parseInt(hex[1].slice(at, at + 2), 16)) : written.match(/[\d.]+/g).slice(0, 3).map(Number);
}

const OPAQUE = 256;

/** Return a colour as one number, as image data stores it. */
function packed(written) {
  const [r, g, b] = channels(written);
  return ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
}

/** A disc or a hollow one of one size for pictures of one width: which pixels it covers, and how much of each. */
class Stamp {
  /**
   * @param {number} radius Radius in px.
   * @param {number} width Width of the picture in px.
   * @param {number} opacity Opacity of the disc, in [0, 1].
   * @param {number} [rim] Width of the rim of a hollow disc in px.
   */
  constructor(radius, width, opacity, rim = radius + 1) {
    this.reach = Math.ceil(radius + 0.5);
    const [places, shares] = [[], []];
    for (let y = -this.reach; y <= this.reach; y += 1) {
      for (let x = -this.reach; x <= this.reach; x += 1) {
        const away = Math.hypot(x, y);
        const covered = Math.max(0, Math.min(1, radius + 0.5 - away, away - (radius - rim) + 0.5));
        if (covered === 0) continue;
        places.push(y * width + x);
        shares.push(Math.round(OPAQUE * covered * opacity));
      }
    }
    this.places = Int32Array.from(places);
    this.shares = Int32Array.from(shares);
  }

  /** Blend a disc of a packed colour into the pixels around an index at least `reach` from the edge of the picture. */
  onto(pixels, place, colour) {
    const { places, shares } = this;
    const redBlue = colour & 0xff00ff;
    const green = colour & 0x00ff00;
    for (let k = 0; k < places.length; k += 1) {
      const at = place + places[k];
      const was = pixels[at];
      const share = shares[k];
      const rest = OPAQUE - share;
      pixels[at] = 0xff000000
        | (((Math.imul(was & 0xff00ff, rest) + Math.imul(redBlue, share)) >>> 8) & 0xff00ff)
        | (((Math.imul(was & 0x00ff00, rest) + Math.imul(green, share)) >>> 8) & 0x00ff00);
    }
  }
}
