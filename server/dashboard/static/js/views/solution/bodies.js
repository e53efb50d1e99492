/** The shapes of road users from above. The pen is in metres, x ahead of nothing but east, y north. */

// Corners in half lengths ahead and half widths to the left, as the replays of the command line have them.
const BODY = polygon([[1, 0.62], [0.9, 0.94], [0.72, 1], [-0.8, 1], [-0.95, 0.92], [-1, 0.7],
  [-1, -0.7], [-0.95, -0.92], [-0.8, -1], [0.72, -1], [0.9, -0.94], [1, -0.62]]);
const WINDOWS = polygon([[0.42, 0.8], [0.42, -0.8], [0.12, -0.68], [0.12, 0.68]],
  [[-0.58, 0.66], [-0.58, -0.66], [-0.76, -0.74], [-0.76, 0.74]]);
const BRAKE_LIGHTS = polygon([[-0.9, 0.9], [-0.9, 0.42], [-1, 0.42], [-1, 0.8]],
  [[-0.9, -0.9], [-0.9, -0.42], [-1, -0.42], [-1, -0.8]]);
const BRAKING_MPS2 = -1;
const LEAST_WALKER_PX = 3.5;

function polygon(...rings) {
  const path = new Path2D();
  for (const ring of rings) {
    ring.forEach(([x, y], index) => (index ? path.lineTo(x, y) : path.moveTo(x, y)));
    path.closePath();
  }
  return path;
}

/**
 * Draw a car.
 *
 * @param {CanvasRenderingContext2D} pen
 * @param {{x: number, y: number, yaw: number}} pose
 * @param {{length_m: number, width_m: number}} size
 * @param {string} fill
 * @param {object} colours
 * @param {{accel: number, outline?: string|null, metresPerPx: number}} more
 */
export function drawCar(pen, pose, size, fill, colours, { accel, outline = null, metresPerPx }) {
  pen.save();
  pen.translate(pose.x, pose.y);
  pen.rotate(pose.yaw);
  pen.scale(size.length_m / 2, size.width_m / 2);
  pen.fillStyle = fill;
  pen.fill(BODY);
  pen.fillStyle = colours.glass;
  pen.fill(WINDOWS);
  if (accel < BRAKING_MPS2) {
    pen.fillStyle = colours.brake;
    pen.fill(BRAKE_LIGHTS);
  }
  pen.restore();
  if (outline) {
    pen.strokeStyle = outline;
    pen.lineWidth = 2.5 * metresPerPx;
    strokeBox(pen, pose, size.length_m + 4 * metresPerPx, size.width_m + 4 * metresPerPx);
  }
}

/** Draw a person: a dot with a nose, never too small to be seen. */
export function drawWalker(pen, pose, colours, metresPerPx) {
  const radius = Math.max(LEAST_WALKER_PX * metresPerPx, 0.35);
  pen.strokeStyle = colours.pedestrian;
  pen.lineWidth = 0.6 * radius;
  pen.beginPath();
  pen.moveTo(pose.x, pose.y);
  pen.lineTo(pose.x + 1.9 * radius * Math.cos(pose.yaw), pose.y + 1.9 * radius * Math.sin(pose.yaw));
  pen.stroke();
  pen.fillStyle = colours.pedestrian;
  pen.strokeStyle = colours.paper;
  pen.lineWidth = metresPerPx;
  pen.beginPath();
  pen.arc(pose.x, pose.y, radius, 0, 2 * Math.PI);
  pen.fill();
  pen.stroke();
}

/** Draw the outline of a box; ``crossed`` draws its diagonals, too. */
export function strokeBox(pen, pose, length_m, width_m, crossed = false) {
  pen.save();
  pen.translate(pose.x, pose.y);
  pen.rotate(pose.yaw);
  const [l, w] = [length_m / 2, width_m / 2];
  pen.beginPath();
  pen.rect(-l, -w, length_m, width_m);
  if (crossed) {
    pen.moveTo(-l, -w);
    pen.lineTo(l, w);
    pen.moveTo(-l, w);
    pen.lineTo(l, -w);
  }
  pen.stroke();
  pen.restore();
}
