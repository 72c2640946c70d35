// SPDX-License-Identifier: Apache-2.0
// The trend of the self-checks: a drawing of one figure, a line for each projector, and the table behind it.
import {fill} from './machine.js';

const kSvg = 'http://www.w3.org/2000/svg';
const kWidth = 640, kHeight = 220, kLeft = 64, kRight = 28, kTop = 14, kBottom = 30;

const shape = (tag, attributes, text = '') => {
  const made = document.createElementNS(kSvg, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.textContent = text;
  return made;
};

// Four significant digits, as a language writes them.
export const figureText = (value, language) => value === null || value === undefined
  ? '–' : value.toLocaleString(language, {maximumSignificantDigits: 4});

// What `checks` say of `figure`: a list of values (null: none) for each projector.
export function linesOf(checks, figure) {
  const most = Math.max(0, ...checks.map(check => check.figures[figure].length));
  const lines = Array.from({length: most}, (_, p) => checks.map(check => check.figures[figure][p] ?? null));
  return lines.some(line => line.some(value => value !== null)) ? lines : [];
}

// Least and most with a little room; never nothing between them.
function rangeOf(lines) {
  const values = lines.flat().filter(value => value !== null);
  const low = Math.min(...values), high = Math.max(...values);
  const room = Math.max(0.08 * (high - low), 0.01 * Math.abs(high), 1e-6);
  return [low - room, high + room];
}

const day = (seconds, language) => new Date(1000 * seconds).toLocaleDateString(language, {day: 'numeric', month: 'numeric'});

// Replaces what `svg` shows. A line's number stands at its end, its dashes are its own: colours are not needed.
export function draw(svg, checks, figure, words, language) {
  const lines = linesOf(checks, figure), o = words.operator.selfchecks;
  const dates = [day(checks[0].at, language), day(checks.at(-1).at, language)];
  svg.setAttribute('viewBox', `0 0 ${kWidth} ${kHeight}`);
  svg.setAttribute('aria-label', fill(o.chart, {figure: o.figures[figure], count: checks.length, first: dates[0], last: dates[1]}));
  const [low, high] = rangeOf(lines);
  const x = i => kLeft + (kWidth - kLeft - kRight) * (checks.length > 1 ? i / (checks.length - 1) : 0.5);
  const y = value => kTop + (kHeight - kTop - kBottom) * (high - value) / (high - low);
  const parts = [];
  for (const share of [0, 0.5, 1]) {
    const value = low + share * (high - low);
    parts.push(shape('line', {class: 'grid', x1: kLeft, x2: kWidth - kRight, y1: y(value), y2: y(value)}),
      shape('text', {class: 'scale', x: kLeft - 8, y: y(value) + 5, 'text-anchor': 'end'}, figureText(value, language)));
  }
  parts.push(shape('text', {class: 'scale', x: kLeft, y: kHeight - 8}, dates[0]),
    shape('text', {class: 'scale', x: kWidth - kRight, y: kHeight - 8, 'text-anchor': 'end'}, dates[1]));
  const ends = [];
  lines.forEach((line, p) => {
    const points = line.map((value, i) => value === null ? null : `${x(i).toFixed(1)} ${y(value).toFixed(1)}`);
    const path = points.map((point, i) => point && `${i && points[i - 1] ? 'L' : 'M'}${point}`).filter(Boolean).join('');
    parts.push(shape('path', {class: `line line-${p % 4}`, d: path}));
    line.forEach((value, i) => value !== null && parts.push(shape('circle', {
      class: checks[i].passed ? `point point-${p % 4}` : 'point point-failed', cx: x(i), cy: y(value), r: 3})));
    const last = line.findLastIndex(value => value !== null);
    if (last >= 0 && lines.length > 1) ends.push({p, y: y(line[last])});
  });
  // Numbers of lines that end close together stand one below the other.
  ends.sort((a, b) => a.y - b.y).forEach((end, i) => {
    if (i) end.y = Math.max(end.y, ends[i - 1].y + 16);
    parts.push(shape('text', {class: 'name', x: kWidth - kRight + 8, y: end.y + 5}, String(end.p)));
  });
  svg.replaceChildren(...parts);
}
