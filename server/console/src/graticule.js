// A quiet net of meridians and parallels with labels at the rim, so that one knows where one is.

import { degrees } from './format.js';

const SPACING_PX = 130;
/** Kept free of labels at the right: the layer switch above, scale and zoom below. */
const TOP_PX = 180;
const BOTTOM_PX = 180;
const INK = 'rgba(150, 185, 225, 0.10)';
const LABEL = 'rgb(168, 188, 212)';
const GROUND = '#070b12';

/** Draws on a canvas above the map, below the controls. */
export function addGraticule(map) {
  const canvas = document.createElement('canvas');
  canvas.className = 'graticule';
  canvas.setAttribute('aria-hidden', 'true');
  map.getCanvasContainer().append(canvas);
  map.on('render', () => draw(map, canvas));
}

function draw(map, canvas) {
  const { clientWidth: width, clientHeight: height } = map.getContainer();
  const ratio = window.devicePixelRatio;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext('2d');
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = '11px ui-monospace, "SF Mono", "DejaVu Sans Mono", monospace';
  pen.lineWidth = 1;
  pen.strokeStyle = INK;
  pen.fillStyle = LABEL;
  pen.lineJoin = 'round';

  const bounds = map.getBounds();
  const { step, digits } = roundStep(((bounds.getEast() - bounds.getWest()) / width) * SPACING_PX);
  const { lng: midLng, lat: midLat } = map.getCenter();

  const labels = [];
  pen.beginPath();
  for (const lng of multiples(bounds.getWest(), bounds.getEast(), step)) {
    const x = Math.round(map.project([lng, midLat]).x) + 0.5;
    pen.moveTo(x, 0);
    pen.lineTo(x, height);
    labels.push(['center', degrees(((lng + 540) % 360) - 180, digits, 'EW'), x, height - 12]);
  }
  for (const lat of multiples(Math.max(bounds.getSouth(), -85), Math.min(bounds.getNorth(), 85), step)) {
    const y = Math.round(map.project([midLng, lat]).y) + 0.5;
    pen.moveTo(0, y);
    pen.lineTo(width, y);
    if (y > TOP_PX && y < height - BOTTOM_PX) labels.push(['right', degrees(lat, digits, 'NS'), width - 10, y - 9]);
  }
  pen.stroke();

  pen.textBaseline = 'middle';
  pen.strokeStyle = GROUND;
  pen.lineWidth = 4;
  for (const [align, text, x, y] of labels) {
    pen.textAlign = align;
    pen.strokeText(text, x, y);
    pen.fillText(text, x, y);
  }
}

/** The 1, 2 or 5 times a power of ten next above, and the digits it needs after the point. */
function roundStep(least) {
  const power = Math.floor(Math.log10(least));
  const factor = [1, 2, 5, 10].find((f) => f * 10 ** power >= least);
  const step = Math.min(factor * 10 ** power, 30);
  return { step, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

function* multiples(low, high, step) {
  for (let i = Math.ceil(low / step); i * step <= high; i += 1) yield i * step;
}
