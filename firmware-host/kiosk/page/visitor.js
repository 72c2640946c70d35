// SPDX-License-Identifier: Apache-2.0
// The visitor's screen shows what the machine says and reports what is pressed; it decides nothing.
import {Machine, fetchJson, fill, post, putTexts, textsOf} from './machine.js';
import {chime, soundIsOn, toggleSound} from './sound.js';

const screen = document.getElementById('screen');
const said = document.getElementById('said');
const stop = document.getElementById('stop');
const lost = document.getElementById('lost');

// Where a visitor may stop by the one button for it. The gate asks how: keeping or deleting.
const kVisit = ['question', 'consent', 'position', 'countdown', 'capture'];
// Where the language may still change.
const kBefore = ['closed', 'idle', 'question', 'consent', 'safe'];
// How long idle shows how the visit before it ended.
const kNoticeMs = 20_000;
// Said aloud while a capture runs.
const kProgressSteps = 4;

let state = null, words = null, shown = '', shownLanguage = '', saidProgress = 0, noticeTimer, updates = Promise.resolve();

const each = (selector, action) => screen.querySelectorAll(selector).forEach(action);
const put = (selector, text) => each(selector, element => {
  if (element.textContent !== text) element.textContent = text;
  element.hidden = text === '';
});
// A screen reader says it; the same text twice is said once.
const say = text => { if (said.textContent !== text) said.textContent = text; };

async function press(verb, more = {}) {
  if (!state) return;
  for (const button of document.querySelectorAll('[data-verb]')) button.disabled = true;
  const {nonce, screen: pressedOn} = state;
  let answer = await post(`/visitor/${verb}`, {nonce, screen: pressedOn, ...more});
  // A stop that nobody heard is said again for as long as this screen stands: the program may be at something else.
  while (answer.status === 0 && verb === 'leave' && state?.nonce === nonce && state.screen === pressedOn) {
    await new Promise(resolve => setTimeout(resolve, 300));
    answer = await post('/visitor/leave', {nonce, screen: pressedOn});
  }
  // What was pressed belonged to another visit or screen: the stream says what is now.
  if (answer.status === 403 || answer.status === 409) machine.open();
  for (const button of document.querySelectorAll('[data-verb]')) button.disabled = false;
}

function scopes() {
  const checked = name => screen.querySelector(`input[name=${name}]`)?.checked ?? false;
  return {research: checked('research'), publication: checked('publication')};
}

function build(name) {
  const template = document.getElementById(`screen-${name}`);
  const kept = name === 'consent' && shown === 'consent' ? scopes() : {};
  const hadFocus = document.activeElement?.closest?.('#languages');
  screen.replaceChildren(template.content.cloneNode(true));
  document.body.dataset.screen = name;
  document.documentElement.lang = state.language;
  putTexts(document.body, words);
  document.title = `${words.title}: ${screen.querySelector('h1').textContent}`;
  each('[data-paragraphs]', element => {
    element.replaceChildren(...words.screens.consent.text.map(text => Object.assign(document.createElement('p'), {textContent: text})));
  });
  for (const [scope, checked] of Object.entries(kept)) screen.querySelector(`input[name=${scope}]`).checked = checked;
  each('[data-verb]', button => button.addEventListener('click', () =>
    press(button.dataset.verb, button.dataset.verb === 'agree' ? scopes() : {})));
  each('[data-go]', button => button.addEventListener('click', () => { build(button.dataset.go); update(); }));
  stop.hidden = !kVisit.includes(name);
  shown = name;
  shownLanguage = state.language;
  showLanguages();
  const heading = screen.querySelector('h1');
  heading.tabIndex = -1;
  if (!hadFocus) heading.focus({preventScroll: true});
}

function update() {
  // The countdown's own words say it.
  const said = shown === 'countdown' && state.word === 'hold';
  const word = said ? '' : words.words[state.word] ?? '';
  put('[data-word]', word);
  put('[data-number]', String(state.number));
  put('[data-attempt]', fill(words.screens.gate.attempt, state));
  put('[data-ticket]', state.ticket ?? '');
  put('[data-opens]', state.opens ? fill(words.screens.closed.opens, {time: state.opens}) : '');
  each('[data-closures]', list => list.replaceChildren(...state.closures.map(name =>
    Object.assign(document.createElement('li'), {textContent: words.closures[name]}))));
  if (shown === 'position') showFace();
  if (shown === 'capture') showProgress();
  // To finish here is to keep: where nothing is worth keeping there is once more, or nothing.
  if (shown === 'gate') screen.querySelector('[data-verb=keep]').hidden = !state.usable;
  if (shown === 'thanks') showTicket();
  if (shown === 'countdown') say(`${state.number}`);
  else if (word && shown === state.screen && shown !== 'idle') say(word);
}

function showNotice() {
  clearTimeout(noticeTimer);
  const notice = words.words[state.word] ?? '';
  put('[data-notice]', notice);
  if (!notice) return;
  say(notice);
  if (shown === 'idle') noticeTimer = setTimeout(() => put('[data-notice]', ''), kNoticeMs);
}

function showFace() {
  const view = document.getElementById('view'), picture = document.getElementById('preview');
  view.classList.toggle('good', state.word === 'hold');
  const place = `/preview.jpg?${state.preview}`;
  if (state.preview && picture.dataset.place !== place) {
    picture.dataset.place = place;
    // The next one is shown when it is whole.
    const next = new Image();
    next.onload = () => {
      picture.src = next.src;
      picture.hidden = false;
      view.style.aspectRatio = `${next.naturalWidth} / ${next.naturalHeight}`;
    };
    next.src = place;
  }
  const face = document.getElementById('face');
  face.style.display = state.box ? '' : 'none';
  if (!state.box) return;
  const [left, top, right, bottom] = state.box;
  for (const [name, value] of Object.entries({x: left, y: top, width: right - left, height: bottom - top}))
    face.setAttribute(name, Math.max(0, value));
}

function showProgress() {
  const bar = document.getElementById('progress');
  bar.max = Math.max(1, state.of);
  bar.value = state.number;
  put('[data-progress]', state.of ? `${state.number} / ${state.of}` : '…');
  const step = state.of ? Math.floor(kProgressSteps * state.number / state.of) : 0;
  if (step > saidProgress) say(`${Math.round(100 * step / kProgressSteps)} %`);
  saidProgress = step;
}

function showTicket() {
  const qr = document.getElementById('qr');
  qr.hidden = !state.ticket;
  if (state.ticket) qr.src = `/ticket.svg?${encodeURIComponent(state.ticket)}`;
}

async function show(next) {
  const before = state;
  state = next;
  words = await textsOf(next.language);
  const fresh = before?.screen !== next.screen || before?.visit !== next.visit;
  if (fresh || shownLanguage !== next.language) {
    // Whoever reads about withdrawing stays there when the same state comes again.
    build(fresh ? next.screen : shown);
    if (shown === 'idle' || shown === 'thanks') showNotice();
    if (fresh && soundIsOn()) chime(next.screen);
  } else if (next.screen === 'countdown' && soundIsOn()) {
    chime('countdown');
  }
  update();
}

let languages = [];
function showLanguages() {
  const group = document.getElementById('languages');
  group.parentElement.hidden = !kBefore.includes(shown);
  for (const button of group.children)
    button.setAttribute('aria-pressed', String(button.lang === state.language));
}

async function begin() {
  languages = await fetchJson('/languages.json');
  document.getElementById('languages').replaceChildren(...languages.map(({id, name}) => {
    const button = Object.assign(document.createElement('button'), {type: 'button', lang: id, textContent: name});
    button.addEventListener('click', () => press('language', {language: id}));
    return button;
  }));
  if (state) showLanguages();
}

const machine = new Machine({
  // One after the other, however long a language takes to come.
  onState: next => { updates = updates.then(() => show(next)).catch(error => console.error(error)); },
  onLost: () => {
    if (!words) return;
    lost.replaceChildren(
      Object.assign(document.createElement('h2'), {textContent: words.lost.title}),
      Object.assign(document.createElement('p'), {textContent: words.lost.text}));
    lost.hidden = false;
    screen.inert = true;
    stop.inert = true;
  },
  onBack: () => {
    lost.hidden = true;
    screen.inert = false;
    stop.inert = false;
    if (!languages.length) begin();
  }
});

stop.addEventListener('click', () => press('leave'));
document.getElementById('sound').addEventListener('click', event =>
  event.currentTarget.setAttribute('aria-pressed', String(toggleSound())));
addEventListener('keydown', event => {
  if (event.key === 'Escape' && !stop.hidden && !event.repeat) press('leave');
});
begin();
