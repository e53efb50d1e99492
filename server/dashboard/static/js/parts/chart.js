/** Lines over a common axis, drawn by uPlot: in the theme's colours, as wide as there is room. */

import { h } from "../dom.js";
import { colour, onTheme } from "../theme.js";

/**
 * Draw lines.
 *
 * @param {object} given
 * @param {string} given.label What the chart shows, for who cannot see it.
 * @param {string} given.x Name of the axis across.
 * @param {{label: string, colour: string, dash?: number[], width?: number, points?: boolean}[]} given.series Colours by name.
 * @param {AbortSignal} given.signal
 * @param {number} [given.height] In px.
 * @param {object} [given.options] More of uPlot's options: ``scales``, ``hooks``, ``cursor``, ``axes``.
 * @returns {HTMLElement} With ``update(columns)``: x, then one column a series; and ``plot``.
 */
export function chart({ label, x, series, signal, height = 220, options = {} }) {
  const place = h("div.chart", { role: "img", "aria-label": label });
  let columns = null;
  let drawn = null;

  function draw() {
    drawn?.destroy();
    drawn = null;
    place.plot = null;
    if (columns === null || place.clientWidth === 0) return;
    const axis = {
      stroke: colour("--muted"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 },
      font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 18,
    };
    const { axes = [{}, {}], ...more } = options;
    drawn = place.plot = new uPlot({
      width: place.clientWidth, height, ms: 1, scales: { x: { time: false } },
      axes: [{ ...axis, label: x, ...axes[0] }, { ...axis, size: 52, ...axes[1] }],
      series: [{ label: x }, ...series.map((line) => ({
        label: line.label, stroke: colour(line.colour), width: line.width ?? 2, dash: line.dash, spanGaps: true,
        points: { show: line.points ?? false }, ...line.more,
      }))],
      legend: { live: true }, cursor: { drag: { x: false, y: false } }, ...more,
    }, columns, place);
    drawn.over.addEventListener("mouseleave", () => requestAnimationFrame(rest));
    requestAnimationFrame(rest); // after its first drawing, which sets the legend, too
  }

  /** While nobody points at the chart, its legend says the latest values. */
  function rest() {
    if (drawn !== null && columns[0].length && (drawn.cursor.left ?? -1) < 0) drawn.setLegend({ idx: columns[0].length - 1 });
  }

  place.update = (next) => {
    const same = columns !== null && next.length === columns.length;
    columns = next;
    if (drawn && same) {
      drawn.setData(columns);
      requestAnimationFrame(rest);
    } else draw();
  };
  const seen = new ResizeObserver(() => {
    if (drawn === null) draw();
    else if (place.clientWidth > 0 && drawn.width !== place.clientWidth) drawn.setSize({ width: place.clientWidth, height });
  });
  seen.observe(place);
  onTheme(draw, signal);
  signal.addEventListener("abort", () => {
    seen.disconnect();
    drawn?.destroy();
  }, { once: true });
  return place;
}
