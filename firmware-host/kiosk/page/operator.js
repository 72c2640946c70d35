// SPDX-License-Identifier: Apache-2.0
// The operator's screen: the machine's state as visitors' screens get it, and figures that are asked for every few seconds.
import {Machine, fetchJson, fill, post, putTexts, textsOf} from './machine.js';
import {draw, figureText, linesOf} from './trend.js';

const kStatusMs = 3000;
const byId = id => document.getElementById(id);

let words = null, state = null, status = null, inside = false, touched = false, sure = '', language = '';

const make = (tag, text, more = {}) => Object.assign(document.createElement(tag), {textContent: text, ...more});
const say = text => { byId('answer').textContent = text; };
const number = (value, digits) => value === null || value === undefined
  ? words.operator.unknown
  : value.toLocaleString(language, {minimumFractionDigits: digits, maximumFractionDigits: digits});
const moment = seconds => new Date(1000 * seconds).toLocaleString(language, {dateStyle: 'short', timeStyle: 'medium'});
const known = (value, text) => value === null || value === undefined ? words.operator.unknown : text;

function putPairs(id, pairs) {
  byId(id).replaceChildren(...pairs.flatMap(([name, value]) => [make('dt', name), make('dd', value)]));
}

function putTable(id, heads, rows, nothing) {
  const table = byId(id);
  if (!rows.length) return table.replaceChildren(Object.assign(make('caption', nothing)));
  const head = document.createElement('tr'), body = document.createElement('tbody');
  head.append(...heads.map(text => make('th', text, {scope: 'col'})));
  for (const row of rows) {
    const line = document.createElement('tr');
    line.append(...row.map((cell, i) => {
      const head = i === (row[0].picture ? 1 : 0);
      const made = make(head ? 'th' : 'td', cell.picture ? '' : cell.text ?? cell, {className: cell.kind ?? '', ...(head ? {scope: 'row'} : {})});
      if (cell.picture) made.append(cell.picture);
      return made;
    }));
    body.append(line);
  }
  const top = document.createElement('thead');
  top.append(head);
  table.replaceChildren(top, body);
}

const kRest = ['idle', 'closed', 'safe'], pictures = new Map();
function pictureOf(session) {
  const known = pictures.get(session.id);
  if (known) return known;
  const place = document.createElement('span');
  if (!kRest.includes(status.screen) || !session.frames) return place;
  const image = Object.assign(new Image(96, 72), {alt: '', src: `/operator/sessions/${encodeURIComponent(session.id)}/picture.jpg`});
  // No key here, no consent: there is none to show.
  image.addEventListener('error', () => { place.textContent = '–'; });
  place.append(image);
  pictures.set(session.id, place);
  return place;
}

function showState() {
  const o = words.operator, phase = byId('phase');
  if (phase.textContent !== o.phases[state.screen]) phase.textContent = o.phases[state.screen];
  phase.className = `phase ${state.screen}`;
  byId('reasons').textContent = state.closures.map(name => words.closures[name]).join(' ');
  putPairs('now', [
    [o.visit, state.visit ? String(state.visit) : '–'],
    [o.finding, words.words[state.word] || '–'],
    ...(state.screen === 'capture' ? [[o.frames, `${state.number} / ${state.of}`]] : [])
  ]);
}

function showDays() {
  const o = words.operator, {today} = status;
  putPairs('today', [
    [o.visits, String(today.visits_begun)],
    ...Object.keys(o.ends).map(end => [o.ends[end], String(today.visits[end] ?? 0)]),
    // What ends a visit seldom has the visitor's words.
    ...Object.entries(today.visits).filter(([end]) => !(end in o.ends)).map(([end, count]) => [words.words[end] ?? end, String(count)]),
    [o.retakes, String(today.retakes)]
  ]);
  // Noon: the same date in every zone that the browser may be in.
  const date = day => new Date(`${day}T12:00:00`).toLocaleDateString(language, {dateStyle: 'short'});
  const count = number => ({text: String(number), kind: 'number'});
  putTable('other-days', [o.day, o.visits, o.ends.kept, o.retakes, o.faults], status.other_days.map(day =>
    [date(day.day), count(day.visits_begun), count(day.visits.kept ?? 0), count(day.retakes), count(day.faults)]), o.no_other_days);
}

// The figures to choose from are those that some check has.
function putFigures(checks) {
  const o = words.operator.selfchecks, select = byId('figure');
  const there = Object.keys(o.figures).filter(name => checks[0].figures[name] && linesOf(checks, name).length);
  const chosen = there.includes(select.value) ? select.value : there[0];
  const shown = [...select.options].map(option => option.value + option.text).join();
  if (shown !== there.map(name => name + o.figures[name]).join())
    select.replaceChildren(...there.map(name => make('option', o.figures[name], {value: name})));
  select.value = chosen;
  return chosen;
}

function driftText(drift) {
  const o = words.operator.selfchecks, of = drift.figure === 'frame_rate' ? o.drift : o.drift_of;
  return fill(of, {figure: o.figures[drift.figure], projector: drift.projector, value: figureText(drift.value, language),
    median: figureText(drift.median, language), limit: drift.limit.toLocaleString(language, {maximumSignificantDigits: 2})});
}

function showSelfchecks() {
  const o = words.operator.selfchecks, {checks, days, fewest_days: fewest, drifts} = status.selfchecks;
  byId('trend').hidden = byId('drifts').hidden = true;
  if (!checks.length) return byId('selfcheck-last').replaceChildren(o.none);
  const last = checks.at(-1);
  byId('selfcheck-last').textContent = `${o.last}: ${moment(last.at)}, ${last.passed ? o.passed : o.failed}. ` +
    (days < fewest ? fill(o.few, {days, fewest}) : drifts.length ? '' : fill(o.usual, {days}));
  byId('drifts').hidden = !drifts.length;
  byId('drifts').replaceChildren(...drifts.map(drift => make('li', driftText(drift))));
  const figure = putFigures(checks);
  if (!figure) return;
  byId('trend').hidden = false;
  const lines = linesOf(checks, figure), name = p => figure === 'frame_rate' ? o.camera : fill(o.projector, {projector: p});
  byId('keys').replaceChildren(...lines.map((_, p) => make('span', name(p), {className: `key key-${p % 4}`})));
  draw(byId('chart'), checks, figure, words, language);
  putTable('checks', [words.operator.when, o.result, ...lines.map((_, p) => name(p))], checks.map((check, i) =>
    [moment(check.at), {text: check.passed ? o.passed : o.failed, kind: check.passed ? '' : 'failed'},
      ...lines.map(line => ({text: figureText(line[i], language), kind: 'number'}))]).reverse(), o.none);
}

// Where this machine runs no batch it knows nothing of one.
function showBatch() {
  const o = words.operator.batch, {timer, next, last, fits} = status.batch;
  putPairs('batch', [
    [o.next, timer === 'on' ? known(next, moment(next)) : o[timer]],
    ...(timer === 'on' ? [[o.last, last === null ? '–' : moment(last)]] : []),
    ...(fits ? [[o.without_fit, String(fits.without_fit)]] : []),
    ...(fits?.has_jobs ? ['waiting', 'fitted', 'failed'].map(name => [o[name], String(fits[name])]) : [])
  ]);
  byId('batch-note').hidden = timer !== 'absent';
}

function showNotes() {
  byId('notes').hidden = !status.notes.length;
  byId('notes').querySelector('ul').replaceChildren(...status.notes.map(note => make('li', note, {lang: 'en'})));
}

function showStatus() {
  const o = words.operator, gib = bytes => `${number(bytes / 2 ** 30, 1)} GiB`;
  putPairs('machine', [
    [o.frame_rate, number(status.frames_per_second, 1)],
    ...(status.temperatures.length ? status.temperatures : [{name: '', celsius: null}]).map(({name, celsius}) =>
      [`${o.temperature} ${name}`, known(celsius, `${number(celsius, 1)} °C`)]),
    [o.disk, known(status.disk_free_bytes, gib(status.disk_free_bytes))],
    [o.calibration, known(status.calibration_age_days, fill(o.days, {days: number(status.calibration_age_days, 0)}))],
    [o.viewers, String(status.viewers)]
  ]);
  showDays();
  showSelfchecks();
  showBatch();
  showNotes();
  putTable('faults', [o.when, o.what], status.faults.map(fault =>
    [moment(fault.at), words.words[fault.word] ?? fault.word]), o.no_faults);
  // Each picture is asked for once, and while nobody is served; of who is forgotten none stays here.
  for (const id of pictures.keys()) if (!status.sessions.some(session => session.id === id)) pictures.delete(id);
  putTable('sessions', [o.picture, o.session, o.started, o.kind, o.status, o.frames, o.findings], status.sessions.map(session =>
    [{picture: pictureOf(session)}, session.id, moment(session.started), session.kind, {text: session.status, kind: session.status},
      {text: String(session.frames), kind: 'number'}, session.findings.join(', ') || '–']), o.no_sessions);
}

function showDoor() {
  byId('door').hidden = inside;
  byId('inside').hidden = !inside;
  byId('leave').hidden = !inside;
}

// Nothing of the sessions stays behind the door.
function forgetPictures() {
  pictures.clear();
  byId('sessions').replaceChildren();
}

async function ask() {
  if (document.hidden) return;
  // What this page asks by itself is no use of the operator's session: a key or a pointer that was pressed since is.
  const headers = touched ? {'Stratalux-Touched': '1'} : {};
  touched = false;
  const answer = await fetch('/operator/status', {headers, cache: 'no-store', signal: AbortSignal.timeout(kStatusMs)}).catch(() => null);
  // Who is busy has signed nobody out.
  if (!answer || answer.status === 503) return;
  const was = inside;
  inside = answer.ok;
  if (was && !inside) forgetPictures();
  if (answer.ok) status = await answer.json();
  if (!words) return;
  if (was !== inside || byId('door').hidden === byId('inside').hidden) showDoor();
  if (inside) showStatus();
}

async function enter(event) {
  event.preventDefault();
  const token = byId('token').value.trim();
  byId('token').value = '';
  const answer = await fetch('/operator/session', {method: 'POST', headers: {Authorization: `Bearer ${token}`}}).catch(() => null);
  say(answer?.status === 429 ? words.operator.too_many : answer?.ok ? '' : words.operator.wrong_token);
  await ask();
  (inside ? byId('inside').querySelector('button') : byId('token')).focus();
}

async function leave() {
  forgetPictures();
  await fetch('/operator/session', {method: 'DELETE'}).catch(() => null);
  await ask();
  byId('token').focus();
}

async function order(place, body) {
  const answer = await post(place, body);
  const good = answer.status >= 200 && answer.status < 300;
  say(good ? words.operator.done : fill(words.operator.refused, {reason: answer.text || String(answer.status)}));
  await ask();
}

function beSure(ticket) {
  sure = ticket;
  byId('sure-ticket').textContent = ticket;
  byId('sure').hidden = !ticket;
  (ticket ? byId('sure-no') : byId('ticket')).focus();
}

async function speak(next) {
  language = next;
  words = await textsOf(next);
  document.documentElement.lang = next;
  putTexts(document, words);
  document.title = `${words.title}: ${words.operator.title}`;
  for (const button of byId('languages').children) button.setAttribute('aria-pressed', String(button.lang === next));
  showDoor();
  if (state) showState();
  if (status && inside) showStatus();
}

async function begin() {
  const languages = await fetchJson('/languages.json');
  byId('languages').replaceChildren(...languages.map(({id, name}) => {
    const button = make('button', name, {type: 'button', lang: id});
    button.addEventListener('click', () => speak(id));
    return button;
  }));
  const mine = navigator.language.slice(0, 2);
  await ask();
  await speak((languages.find(({id}) => id === mine) ?? languages[0]).id);
  new Machine({
    onState: next => { state = next; showState(); },
    onLost: () => {
      byId('lost').replaceChildren(make('p', words.lost.title));
      byId('lost').hidden = false;
    },
    onBack: () => { byId('lost').hidden = true; }
  });
  setInterval(ask, kStatusMs);
}

for (const input of ['keydown', 'pointerdown', 'wheel'])
  addEventListener(input, () => { touched = true; }, {capture: true, passive: true});
byId('door').addEventListener('submit', enter);
byId('leave').addEventListener('click', leave);
byId('figure').addEventListener('change', showSelfchecks);
for (const button of document.querySelectorAll('[data-command]'))
  button.addEventListener('click', () => order(`/operator/${button.dataset.command}`, {}));
byId('withdraw').addEventListener('submit', event => {
  event.preventDefault();
  beSure(byId('ticket').value.trim());
});
byId('sure-no').addEventListener('click', () => beSure(''));
byId('sure-yes').addEventListener('click', async () => {
  const ticket = sure;
  byId('ticket').value = '';
  beSure('');
  await order('/operator/withdraw', {ticket});
});
begin();
