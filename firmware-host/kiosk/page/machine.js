// SPDX-License-Identifier: Apache-2.0
// What both pages share: the machine's state as it comes, the words of a language, what people press.

export async function fetchJson(place) {
  const answer = await fetch(place, {cache: 'no-cache'});
  if (!answer.ok) throw new Error(`${place}: ${answer.status}`);
  return answer.json();
}

// Every language is asked for once.
const texts = new Map();
export async function textsOf(language) {
  if (!texts.has(language)) texts.set(language, await fetchJson(`/languages/${language}.json`));
  return texts.get(language);
}

// "screens.idle.title" -> text.
export function lookUp(words, key) {
  return key.split('.').reduce((place, name) => place?.[name], words);
}

// "Attempt {number} of {of}".
export function fill(text, values) {
  return text.replace(/\{(\w+)\}/g, (whole, name) => values[name] ?? whole);
}

export function putTexts(root, words) {
  for (const element of root.querySelectorAll('[data-text]')) element.textContent = lookUp(words, element.dataset.text);
  for (const element of root.querySelectorAll('[data-label]'))
    element.setAttribute('aria-label', lookUp(words, element.dataset.label));
  for (const element of root.querySelectorAll('[data-alt]')) element.alt = lookUp(words, element.dataset.alt);
}

const kRetryMs = 2000, kPatienceMs = 3000, kLookMs = 5000;

// The machine's states, one after the other. A stream that ends is opened again. A cable that was pulled ends nothing,
// so the machine is asked now and then whether it is there.
export class Machine {
  constructor({onState, onLost, onBack}) {
    this.onState = onState;
    this.onLost = onLost;
    this.onBack = onBack;
    this.lost = false;
    this.open();
    setInterval(() => this.look(), kLookMs);
    addEventListener('offline', () => this.miss());
    addEventListener('online', () => this.open());
  }

  open() {
    clearTimeout(this.again);
    this.source?.close();
    const source = new EventSource('/events');
    this.source = source;
    source.addEventListener('state', event => {
      this.found();
      this.onState(JSON.parse(event.data));
    });
    source.onerror = () => {
      // A refusal ends the browser's own attempts.
      if (source.readyState === EventSource.CLOSED) this.again = setTimeout(() => this.open(), kRetryMs);
      this.doubt ??= setTimeout(() => this.miss(), kPatienceMs);
    };
  }

  async look() {
    try {
      const answer = await fetch('/healthz', {cache: 'no-store', signal: AbortSignal.timeout(kPatienceMs)});
      if (answer.status >= 500 && answer.status !== 503) throw new Error('not there');
      if (this.lost) this.open();
    } catch {
      this.miss();
    }
  }

  found() {
    clearTimeout(this.doubt);
    this.doubt = undefined;
    if (this.lost) this.onBack();
    this.lost = false;
  }

  miss() {
    clearTimeout(this.doubt);
    this.doubt = undefined;
    if (!this.lost) this.onLost();
    this.lost = true;
  }
}

// Status of the answer; 0: none came.
export async function post(place, body) {
  try {
    const answer = await fetch(place, {
      method: 'POST', headers: {'Content-Type': 'application/json'}, body: JSON.stringify(body),
      signal: AbortSignal.timeout(kPatienceMs)
    });
    return {status: answer.status, text: (await answer.text()).trim()};
  } catch {
    return {status: 0, text: ''};
  }
}
