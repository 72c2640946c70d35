// SPDX-License-Identifier: Apache-2.0
// The live picture with its figures; what is chosen goes to the program, which says what holds.
const byId = id => document.getElementById(id);
// Above, a face will hardly have all its light in the frames.
const kMuchSaturated = 0.005;
let best = 0, light, shown = 0, loading = false, limits = '';

// A refusal stays until the next choice: the pictures' own news comes many times a second, and is another line.
async function order(place) {
  const answer = await fetch(place, {method: 'POST'}).catch(() => null);
  byId('refused').textContent = answer && !answer.ok ? await answer.text() : '';
}

function putLights(look) {
  const group = byId('light');
  if (group.querySelectorAll('input').length !== look.projectors + 1) {
    group.replaceChildren(group.firstElementChild, ...[-1, ...Array(look.projectors).keys()].map(projector => {
      const label = document.createElement('label'), input = Object.assign(document.createElement('input'), {
        type: 'radio', name: 'light', value: String(projector)});
      input.addEventListener('change', () => order(`/light/${projector < 0 ? 'off' : projector}`));
      label.append(input, projector < 0 ? 'off' : `white of projector ${projector}`);
      return label;
    }));
  }
  group.querySelector(`input[value="${look.light}"]`).checked = true;
  for (const input of group.querySelectorAll('input')) input.disabled = look.stopped && input.value !== '-1';
}

function putExposure(look) {
  const field = byId('exposure'), next = `${look.shortest_ms} ${look.longest_ms} ${look.exposure_ms}`;
  if (limits === next) return;
  limits = next;
  const fixed = look.shortest_ms === look.longest_ms;
  field.value = look.exposure_ms;
  field.disabled = fixed;
  byId('expose').querySelector('button').disabled = fixed;
  byId('limits').textContent = fixed ? 'This camera has one exposure.' : `${look.shortest_ms} to ${look.longest_ms}`;
  best = 0;
}

function putFigures(look) {
  const percent = share => `${(100 * share).toFixed(share < 0.1 ? 2 : 0)} %`;
  best = Math.max(best, look.focus);
  byId('focus').textContent = look.focus.toPrecision(3);
  byId('best').textContent = best.toPrecision(3);
  byId('sharp').value = best > 0 ? look.focus / best : 0;
  byId('level').textContent = percent(look.level);
  byId('bright').textContent = percent(look.bright);
  byId('saturated').textContent = percent(look.saturated);
  byId('saturated').classList.toggle('high', look.saturated > kMuchSaturated);
}

// One picture at a time: a slow line shows fewer.
function putPicture(number) {
  if (loading || number === shown) return;
  loading = true;
  const next = new Image();
  next.onload = next.onerror = () => { loading = false; };
  next.addEventListener('load', () => {
    shown = number;
    byId('picture').src = next.src;
    byId('picture').hidden = false;
    byId('picture').parentElement.style.setProperty('--ratio', next.naturalWidth / next.naturalHeight);
  });
  next.src = `/preview.jpg?${number}`;
}

const source = new EventSource('/events');
source.addEventListener('look', event => {
  const look = JSON.parse(event.data);
  byId('lost').hidden = true;
  if (look.light !== light) best = 0;
  light = look.light;
  putLights(look);
  putExposure(look);
  byId('why').textContent = look.why;
  byId('reset').hidden = !look.stopped;
  if (!look.picture) return;
  putFigures(look);
  putPicture(look.picture);
});
source.onerror = () => { byId('lost').hidden = false; };
byId('reset').addEventListener('click', () => order('/reset'));
byId('again').addEventListener('click', () => { best = 0; });
byId('expose').addEventListener('submit', event => {
  event.preventDefault();
  order(`/exposure/${Number(byId('exposure').value)}`);
});
