// How a figure is drawn into a box, in the colour of the page's text, or drawn again.
'use strict';
const ink = () => getComputedStyle(document.body).color;
const options = {responsive: true, displaylogo: false, plotlyServerURL: '',
  modeBarButtonsToRemove: ['select2d', 'lasso2d', 'autoScale2d', 'resetCameraLastSave3d']};
const webgl = Boolean(document.createElement('canvas').getContext('webgl'));
async function draw(box, {data, layout}) {
  box.classList.toggle('spatial', Boolean(layout.scene));
  if (layout.scene && !webgl) {
    box.textContent = 'The view in 3-D needs WebGL, which this browser does not offer.';
    box.style.height = 'auto';
    return;
  }
  layout.font.color = ink();
  if (innerWidth < 640) {
    layout.dragmode = false;  // there, a drag scrolls the page
    const eye = layout.scene?.camera.eye;
    for (const axis in eye) eye[axis] *= 1.3;
  }
  await Plotly.react(box, data, layout, options);
}
