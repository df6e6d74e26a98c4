// What is in a folded section is drawn when it is opened and let go of when it is closed: browsers
// allow a page few 3-D contexts. A pointer over the errors shows where on the path that was.
'use strict';
async function fill(box) {
  await draw(box, JSON.parse(box.nextElementSibling.textContent));
  if (box.dataset.shows === 'errors') box.on?.('plotly_hover', event => point(box, event));
}
function point(box, event) {
  const seconds = event.points[0].x;
  for (const path of box.closest('.run').querySelectorAll('.js-plotly-plot[data-shows=path]')) {
    const {x, y, z, customdata} = path.data.find(of => of.customdata), last = path.data.length - 1;
    let k = 0;
    customdata.forEach((at, n) => {
      if (at !== null && Math.abs(at - seconds) < Math.abs(customdata[k] - seconds)) k = n;
    });
    Plotly.restyle(path, {x: [[x[k]]], y: [[y[k]]], ...(z && {z: [[z[k]]]})}, [last]);
  }
}
function show() {
  for (const box of document.querySelectorAll('.plot')) {
    const hidden = box.closest('details:not([open])') !== null;
    if (Boolean(box.drawn) !== hidden) continue;
    box.drawn = !hidden;
    if (hidden) Plotly.purge(box); else fill(box);
  }
}
for (const folded of document.querySelectorAll('details')) {
  folded.addEventListener('toggle', show);
}
function unfold() {
  const named = document.getElementById(location.hash.slice(1));
  if (named?.tagName === 'DETAILS') named.open = true;
}
addEventListener('hashchange', unfold);
unfold();
show();
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
  for (const box of document.querySelectorAll('.js-plotly-plot')) {
    Plotly.relayout(box, {'font.color': ink()});
  }
});
// a page is printed in black on white, whatever the screen shows, and plots as wide as the paper
function fit(colour) {
  for (const box of document.querySelectorAll('.js-plotly-plot')) {
    if (box.offsetParent) Plotly.relayout(box, {'font.color': colour, autosize: true});
  }
}
addEventListener('beforeprint', () => fit('#1b1f24'));
addEventListener('afterprint', () => fit(ink()));
