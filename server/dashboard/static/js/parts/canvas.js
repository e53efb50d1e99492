/** A canvas as large as its place and as sharp as the screen; drawn again when either, or the theme, changes. */

import { h } from "../dom.js";
import { onTheme } from "../theme.js";

const SHARPEST = 2;

/**
 * Return a place with a canvas in it; its ``redraw`` draws it, once it has a size.
 *
 * @param {object} given
 * @param {string} given.label What it shows, for who cannot see it.
 * @param {number} given.ratio Width by height.
 * @param {number} [given.least] Least height in px.
 * @param {number} [given.most] Greatest height in px.
 * @param {(pen: CanvasRenderingContext2D, width: number, height: number, scale: number) => void} given.draw Draws it in px;
 *   the scale is how many of the screen's make one.
 * @param {() => void} [given.recolour] Called before it is drawn in another theme's colours.
 * @param {AbortSignal} given.signal
 */
export function canvas({ label, ratio, least = 0, most = Infinity, draw, recolour, signal }) {
  const sheet = h("canvas", { role: "img", "aria-label": label });
  const place = h("div.canvas", null, sheet);
  const pen = sheet.getContext("2d");
  let width = 0;
  let height = 0;
  let scale = 1;

  function fit() {
    const wide = place.clientWidth;
    if (wide === 0) return;
    const high = Math.round(Math.min(most, Math.max(least, wide / ratio)));
    const sharp = Math.min(SHARPEST, devicePixelRatio || 1);
    if (wide === width && high === height && sharp === scale) return;
    [width, height, scale] = [wide, high, sharp];
    sheet.width = Math.round(wide * sharp);
    sheet.height = Math.round(high * sharp);
    sheet.style.width = `${wide}px`;
    sheet.style.height = `${high}px`;
    place.redraw();
  }

  place.sheet = sheet;
  place.redraw = () => {
    if (width === 0 || signal.aborted) return;
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    draw(pen, width, height, scale);
  };
  const seen = new ResizeObserver(fit);
  seen.observe(place);
  onTheme(() => {
    recolour?.();
    place.redraw();
  }, signal);
  signal.addEventListener("abort", () => seen.disconnect(), { once: true });
  return place;
}
