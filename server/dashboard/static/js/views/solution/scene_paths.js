/** What does not move, as paths in metres: neighbouring surfaces of one kind are drawn at once. */

import { surfaceColours } from "./palette.js";

const STANDS = new Set(["building", "parked-car", "tree"]);

/**
 * Return the paths of a scene, in the order of drawing.
 *
 * @param {{kind: string, closed: boolean, width_m: number, points: [number, number][]}[]} surfaces
 * @returns {{path: Path2D, kind: string, closed: boolean, width_m: number}[]}
 */
export function scenePaths(surfaces) {
  const found = [];
  for (const { kind, closed, width_m, points } of surfaces) {
    if (points.length < 2) continue;
    let last = found.at(-1);
    if (!last || last.kind !== kind || last.closed !== closed || last.width_m !== width_m) {
      last = { path: new Path2D(), kind, closed, width_m };
      found.push(last);
    }
    trace(last.path, points, closed);
  }
  return found;
}

/** Return a line through points in metres. */
export function linePath(points) {
  const path = new Path2D();
  trace(path, points, false);
  return path;
}

function trace(path, points, closed) {
  points.forEach(([x, y], index) => (index ? path.lineTo(x, y) : path.moveTo(x, y)));
  if (closed) path.closePath();
}

/** Draw a scene; the pen is in metres. The route lies on the road and under whatever stands beside it. */
export function drawScene(pen, paths, route, colours, metresPerPx) {
  let routed = false;
  const drawRoute = () => {
    routed = true;
    pen.strokeStyle = colours.route;
    pen.lineWidth = 0.3;
    pen.stroke(route);
  };
  pen.lineJoin = "round";
  for (const { path, kind, closed, width_m } of paths) {
    if (!routed && STANDS.has(kind)) drawRoute();
    const [fill, edge] = surfaceColours(kind);
    if (!closed) {
      pen.strokeStyle = colours[fill];
      pen.lineWidth = Math.max(width_m, metresPerPx);
      pen.stroke(path);
      continue;
    }
    pen.fillStyle = colours[fill];
    pen.fill(path);
    if (edge) {
      pen.strokeStyle = colours[edge];
      pen.lineWidth = metresPerPx;
      pen.stroke(path);
    }
  }
  if (!routed) drawRoute();
}
