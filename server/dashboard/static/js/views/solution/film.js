/** What the camera really saw: its pictures, perturbed as the detector was shown them, with boxes on them. */

import { eachRow, LABELS } from "./episode.js";
import { Pictures } from "./pictures.js";
import { label } from "./sketch.js";

const PERSON = 1;
const [NAME_PX, SCORE_PX, LINE_PX] = [80, 34, 16];
/** Room for a name with its score, for a score, for a line of either. */

/** Draws the picture of any sample of one episode: the latest that was kept, with its boxes. */
export class FilmPlayer {
  #shown = -1;

  constructor(episode, colours, path, redraw, signal) {
    this.film = episode.film;
    this.colours = colours;
    this.pictures = new Pictures(path, this.film.samples.length, redraw, signal);
    this.unsure = false;
  }

  /** Draw a sample into a picture of a width and height in px. Until a picture is there, the one before it stays. */
  draw(pen, sample, width, height) {
    const { film, pictures } = this;
    const wanted = this.#placeOf(sample);
    const here = wanted < 0 ? null : pictures.at(wanted);
    if (here || pictures.isMissing(wanted)) this.#shown = wanted;
    const bitmap = here ?? pictures.kept(this.#shown);
    pen.fillStyle = this.colours.pictureShade;
    pen.fillRect(0, 0, width, height);
    if (bitmap) pen.drawImage(bitmap, 0, 0, width, height);
    const place = this.#shown >= 0 ? this.#shown : wanted;
    if (place >= 0) this.#drawBoxes(pen, film.samples[place], width, height);
    return { missing: pictures.isMissing(wanted) };
  }

  #placeOf(sample) {
    const { samples } = this.film;
    let place = -1;
    let high = samples.length - 1;
    let low = 0;
    while (low <= high) {
      const middle = (low + high) >> 1;
      if (samples[middle] <= sample) {
        place = middle;
        low = middle + 1;
      } else {
        high = middle - 1;
      }
    }
    return samples.length ? Math.max(0, place) : -1;
  }

  #drawBoxes(pen, sample, width, height) {
    const { film, colours } = this;
    const [x, y] = [width / film.size_px[0], height / film.size_px[1]];
    for (const [name, corners] of Object.entries(film.regions)) {
      pen.strokeStyle = colours.pictureRegion;
      pen.lineWidth = 1.5;
      pen.setLineDash(name === "warning" ? [] : [3, 4]);
      pen.beginPath();
      corners.forEach(([px, py], index) => (index ? pen.lineTo(px * x, Math.min(height - 1, py * y)) : pen.moveTo(px * x, py * y)));
      pen.closePath();
      pen.stroke();
    }
    pen.setLineDash([]);
    const box = (row, columns) => [columns.x_min_px[row] * x, columns.y_min_px[row] * y,
      (columns.x_max_px[row] - columns.x_min_px[row]) * x, (columns.y_max_px[row] - columns.y_min_px[row]) * y];
    eachRow(film.judged, sample, (row, columns) => {
      if (columns.ignored[row]) return;
      pen.strokeStyle = colours.pictureTrue;
      pen.lineWidth = 2;
      pen.strokeRect(...box(row, columns));
    });
    const names = [];
    eachRow(film.found, sample, (row, columns) => {
      const sure = columns.score[row] >= film.threshold;
      if (!sure && !this.unsure) return;
      pen.globalAlpha = sure ? 1 : 0.55;
      pen.strokeStyle = colours.pictureFound;
      pen.lineWidth = sure ? 2 : 1;
      pen.setLineDash([6, 3]);
      pen.strokeRect(...box(row, columns));
      pen.globalAlpha = 1;
      if (sure) names.push({ person: columns.label[row] === PERSON, score: columns.score[row], at: box(row, columns) });
    });
    pen.setLineDash([]);
    names.sort((a, b) => b.person - a.person || b.score - a.score);
    const placed = [];
    for (const { person, score, at } of names) {
      const [left, top] = at;
      const wide = person ? NAME_PX : SCORE_PX;
      // Two names on one spot read as neither: people and what is sure come first.
      if (placed.some((other) => left < other.left + other.wide && other.left < left + wide && Math.abs(top - other.top) < LINE_PX)) continue;
      placed.push({ left, top, wide });
      label(pen, `${person ? `${LABELS[PERSON]} ` : ""}${score.toFixed(2)}`, at, width, colours.pictureFound, colours.pictureShade);
    }
  }
}
