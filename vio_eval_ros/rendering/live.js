// Shows what the evaluator says once a second. Names come from others: they are only ever text.
'use strict';
const badge = document.querySelector('header .badge');
const place = document.querySelector('main');
let latest, shown = '';
function element(name, looks, ...content) {
  const made = document.createElement(name);
  made.className = looks;
  made.append(...content);
  return made;
}
function is(word, text) {
  badge.className = `badge ${word}`;
  badge.textContent = text;
}
function figures() {
  const plots = element('div', 'plots');
  for (const label of ['path from above', 'errors over time']) {
    const box = element('div', 'plot');
    box.setAttribute('role', 'img');
    box.setAttribute('aria-label', label);
    box.style.setProperty('--height', '380px');
    plots.append(box);
  }
  return plots;
}
function section({label}) {
  return element('section', '', element('h2', '', label), element('p', 'soft'),
    element('div', 'tiles'), figures(), element('p', 'soft caption'),
    element('table', '', element('tbody', '')));
}
function update(part, {topics, tiles, caption, statuses, figures}) {
  part.querySelector('p').textContent = topics;
  part.querySelector('.tiles').replaceChildren(...tiles.map(([name, value, of]) =>
    element('div', 'tile', element('small', '', name), element('b', '', value),
      element('small', '', of))));
  part.querySelector('.caption').textContent = caption;
  part.querySelector('tbody').replaceChildren(...statuses.map(([name, word, level, message]) =>
    element('tr', '', element('td', 'word', name),
      element('td', '', element('span', `badge ${word}`, level)), element('td', '', message))));
  part.querySelector('.plots').style.display = figures.length ? '' : 'none';
  part.querySelectorAll('.plot').forEach((box, k) => figures[k] && draw(box, figures[k]));
}
function show() {
  if (!latest || document.hidden) return;
  const {run, estimates} = JSON.parse(latest), labels = JSON.stringify(estimates.map(e => e.label));
  document.getElementById('run').textContent = `run ${run}`;
  if (labels !== shown) {
    place.querySelectorAll('.js-plotly-plot').forEach(box => Plotly.purge(box));
    place.replaceChildren(...estimates.map(section));
    shown = labels;
  }
  estimates.forEach((estimate, k) => update(place.children[k], estimate));
}
const events = new EventSource('events');
events.addEventListener('message', ({data}) => {
  latest = data;
  is('pass', 'live');
  show();
});
events.addEventListener('error', () => is('fail', 'no connection'));
document.addEventListener('visibilitychange', show);
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', show);
