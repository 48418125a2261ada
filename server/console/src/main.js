// The operators' page: a radar map and what happens on it.

import { Popup } from 'maplibre-gl';
import 'maplibre-gl/dist/maplibre-gl.css';
import './console.css';
import { byId, calm, el, gathered } from './dom.js';
import { addFixes, drawFixes, fixDetails, outline, tileDetails } from './fixes.js';
import { LAYERS, addRadar, createMap, frame, refresh, showLayer } from './map.js';
import { showFixes, showHealth, showProgress, showStream, showTotals, showUploads } from './panel.js';
import { ask, follow } from './service.js';

const KEPT = 500;
// Asked before the map begins to write its view there.
const framed = location.hash.includes('view=');
const map = createMap();
const state = { fixes: [], uploads: [], kept: [], layer: 'evidence', seen: undefined, framed };

// What is shown: the layer, its legend, the numbers.

async function chooseLayer(layer) {
  state.layer = layer;
  document.querySelector(`input[name=layer][value=${layer}]`).checked = true;
  const hash = new URLSearchParams(location.hash.slice(1));
  hash.set('layer', layer);
  history.replaceState(null, '', `#${[...hash].map(([name, value]) => `${name}=${value}`).join('&')}`);
  if (map.getLayer(layer)) showLayer(map, layer);
  await describeLayer();
}

async function describeLayer() {
  const { layer } = state;
  const { description, legend } = await ask(`/tiles/${layer}.json`);
  if (state.layer !== layer) return;
  byId('about').textContent = description;
  byId('ramp').style.background = `linear-gradient(90deg, ${legend.map(({ color }) => color).join(', ')})`;
  byId('legend').replaceChildren(...legend.filter(({ label }) => label).map(({ label }) => el('li', { textContent: label })));
}

async function loadMap() {
  const answer = await ask('/api/v1/map');
  showTotals(answer);
  showProgress(answer);
  if (!byId('legend').hasChildNodes()) await describeLayer();
  if (!state.framed && answer.bounds) {
    state.framed = true;
    frame(map, answer);
  }
}

/** The last fixes; none for who may not see where somebody is. */
const fixesIfShown = () =>
  ask(`/api/v1/fixes?limit=${KEPT}`).catch((error) => {
    if (error.status !== 403) throw error;
    return { fixes: [] };
  });

async function loadFeeds() {
  const [{ fixes }, { uploads }] = await Promise.all([fixesIfShown(), ask('/api/v1/uploads?limit=50')]);
  Object.assign(state, { fixes, uploads });
  redraw();
}

const quietly = (work) => () => work().catch((error) => console.warn(error.message));
const redraw = gathered(() => {
  showFixes(state.fixes, choose);
  showUploads(state.uploads);
  drawFixes(map, state.fixes);
}, 120);
const newMap = gathered(quietly(async () => {
  await loadMap();
  refresh(map, state.layer);
}), 2000);

// What is clicked: a fix, or a tile.

let popup;
function open(at, content) {
  popup?.remove();
  popup = new Popup({ maxWidth: '320px', offset: 14 }).setLngLat(at).setDOMContent(content).addTo(map);
  popup.on('close', () => outline(map, undefined));
}

function choose(fix) {
  const at = [fix.longitude_deg, fix.latitude_deg];
  map.easeTo({ center: at, zoom: Math.max(map.getZoom(), 18), animate: !calm.matches });
  open(at, fixDetails(fix));
}

async function chooseAt({ point, lngLat }) {
  const near = [[point.x - 6, point.y - 6], [point.x + 6, point.y + 6]];
  const [hit] = map.queryRenderedFeatures(near, { layers: ['fix'] });
  if (hit) {
    const fix = state.fixes[hit.properties.index];
    return open([fix.longitude_deg, fix.latitude_deg], fixDetails(fix));
  }
  try {
    const tile = await ask(`/api/v1/tiles/at?lat=${lngLat.lat.toFixed(7)}&lon=${lngLat.lng.toFixed(7)}`);
    open(lngLat, tileDetails(tile));
    outline(map, tile);
  } catch (error) {
    popup?.remove();
    if (error.status !== 404) console.warn(error.message);
  }
}

// What happens.

map.once('load', () => {
  addRadar(map);
  addFixes(map);
  showLayer(map, state.layer);
  map.on('click', chooseAt);
  map.on('mouseenter', 'fix', () => (map.getCanvas().style.cursor = 'pointer'));
  map.on('mouseleave', 'fix', () => (map.getCanvas().style.cursor = ''));
  redraw();
  // Fixes fade and ages grow also when nothing happens.
  setInterval(() => document.hidden || redraw(), 1000);
});

/** An upload, with what vetting said of it. */
function marked(upload) {
  const kept = upload.epoch && state.kept.find(({ epoch }) => epoch === upload.epoch);
  return kept ? { ...upload, outcome: 'QUARANTINED', kept } : upload;
}

follow({
  open() {
    showStream('live');
    quietly(loadMap)();
    quietly(loadFeeds)();
  },
  lost: () => showStream('lost'),
  health: showHealth,
  map(progress) {
    showProgress(progress);
    const seen = `${progress.state} ${progress.epoch}`;
    if (state.seen !== undefined && state.seen !== seen) newMap();
    state.seen = seen;
  },
  fix(fix) {
    state.fixes = [fix, ...state.fixes].slice(0, KEPT);
    redraw();
  },
  upload(upload) {
    state.uploads = [upload, ...state.uploads].slice(0, 50).map(marked);
    redraw();
  },
  quarantine(event) {
    // It may come before the upload itself.
    state.kept = [event, ...state.kept].slice(0, 50);
    state.uploads = state.uploads.map(marked);
    redraw();
  },
  missed: () => quietly(loadFeeds)(),
});

for (const input of document.querySelectorAll('input[name=layer]')) {
  input.addEventListener('change', () => quietly(() => chooseLayer(input.value))());
}
byId('fold').addEventListener('click', ({ currentTarget }) => {
  const folded = byId('panel').classList.toggle('folded');
  currentTarget.setAttribute('aria-expanded', String(!folded));
});
const asked = new URLSearchParams(location.hash.slice(1)).get('layer');
quietly(() => chooseLayer(LAYERS.includes(asked) ? asked : 'evidence'))();
