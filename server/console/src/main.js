// The operators' page: a radar map and what happens on it.

import { Popup } from 'maplibre-gl';
import 'maplibre-gl/dist/maplibre-gl.css';
import './console.css';
import { byId, calm, el, gathered } from './dom.js';
import { addBase } from './base.js';
import { contributorsPanel } from './contributors.js';
import { addFixes, cellDetails, drawFixes, fixDetails, outline, tileDetails } from './fixes.js';
import { decide } from './decide.js';
import { showHistory } from './history.js';
import { words } from './format.js';
import { LAYERS, addRadar, createMap, forgetBadView, frame, refresh, showEpoch, showLayer } from './map.js';
import { showAges, showFixes, showHealth, showProgress, showRates, showStale, showStream, showTotals, showUploads } from './panel.js';
import { addDifference, drawDifference, timeControls } from './past.js';
import { addQuarantine, drawQuarantine, showQuarantine } from './quarantine.js';
import { meant, meantFix } from './search.js';
import { ask, follow } from './service.js';
import { addSignIn, operates } from './signin.js';
import { tabs } from './tabs.js';

const KEPT = 500;
forgetBadView();
// Asked before the map begins to write its view there.
const framed = location.hash.includes('view=');
const map = createMap();
/** Resolves once it is known who looks. */
const known = addSignIn();
const state = {
  fixes: [], uploads: [], kept: [], quarantine: { quarantined: 0, uploads: [], alarms: [] }, history: { events: [] },
  told: undefined, layer: 'evidence', epoch: undefined, seen: undefined, framed, filter: '', whole: undefined,
};

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
  const { description, legend } = await ask(`tiles/${layer}.json`);
  if (state.layer !== layer) return;
  byId('about').textContent = description;
  byId('ramp').style.background = `linear-gradient(90deg, ${legend.map(({ color }) => color).join(', ')})`;
  byId('legend').replaceChildren(...legend.filter(({ label }) => label).map(({ label }) => el('li', { textContent: label })));
}

async function loadMap() {
  const [answer, then] = await Promise.all([ask('api/v1/map'), state.epoch === undefined ? undefined : ask(`api/v1/map?epoch=${state.epoch}`)]);
  showTotals(then ?? answer);
  showProgress(answer);
  state.whole = then ?? answer;
  if (!byId('legend').hasChildNodes()) await describeLayer();
  if (!state.framed && answer.bounds) {
    state.framed = true;
    frame(map, answer);
  }
}

async function loadFeeds() {
  await known;
  // Fixes tell where somebody is: not all who may look at the map are told of them.
  const told = operates() ? ask(`api/v1/fixes?limit=${KEPT}`) : { fixes: [] };
  const [{ fixes }, { uploads }] = await Promise.all([told, ask('api/v1/uploads?limit=50')]);
  Object.assign(state, { fixes, uploads: uploads.map(marked) });
  redraw();
}

async function loadDecisions() {
  const [quarantine, past] = await Promise.all([ask('api/v1/map/quarantine'), ask('api/v1/map/history?limit=100')]);
  // What says the same is left as it is: somebody may be about to press one of its buttons.
  const told = JSON.stringify([quarantine, past]);
  if (told === state.told) return;
  Object.assign(state, { quarantine, history: past, told });
  showQuarantine(quarantine, { go: goTo, revoke });
  showHistory(past, { look, rollback, undo });
  time.range(past);
  drawQuarantine(map, quarantine);
  state.uploads = state.uploads.map(marked);
  redraw();
}

// What is decided.

const preview = (change) => drawDifference(map, change);

async function decided(title, route, body) {
  try {
    if (await decide(title, route, body, { preview })) say('Decided. The map follows.');
  } catch (error) {
    say(error.message);
  }
  await Promise.all([loadDecisions(), loadContributors()]);
}

/** Only where somebody looks at them. */
const loadContributors = async () => byId('p-contributors').hidden || contributors.load();

const revoke = (body, title) => quietly(() => decided(title, 'revoke', body))();
const rollback = (event) => quietly(() => decided(`Roll the map back to epoch ${event.last}?`, 'rollback', { epoch: event.last }))();
const undo = (event) => quietly(() => decided(`Undo decision ${event.last}?`, 'undo', { decision: event.last }))();

// The past.

const time = timeControls(
  quietly(async (epoch) => {
    state.epoch = epoch;
    showEpoch(map, epoch, state.layer);
    await loadMap();
  }),
  quietly(async (epoch) => {
    const change = epoch === undefined ? undefined : await ask(`api/v1/map/diff?from=${epoch}&to=${state.history.newest}`);
    drawDifference(map, change);
  }),
);

const look = (epoch) => time.to(epoch);

const contributors = contributorsPanel({
  find: (of) => quietly(findId)(of.upload_id),
  revoke: (body, title) => revoke(body, title),
  undo: (event) => undo(event),
  failed: (error) => say(error.message),
});

// The search.

/** `act` is what can be done about it: words, and a function. */
function say(text, [label, act] = []) {
  byId('found').textContent = text ?? '';
  byId('found-act').hidden = !act;
  byId('found-act').textContent = label ?? '';
  byId('found-act').onclick = act ?? null;
}

function goTo({ place }) {
  if (place) map.easeTo({ center: [place.lon, place.lat], zoom: Math.max(map.getZoom(), 18), animate: !calm.matches });
}

async function find(text) {
  const sought = meant(text);
  say(undefined);
  if (!sought) return;
  if (sought.lat !== undefined) {
    goTo({ place: sought });
    await chooseAt({ lngLat: { lat: sought.lat, lng: sought.lon } });
  } else if (sought.tile) {
    const tile = await ask(`api/v1/tiles/${sought.tile}${epochQuery()}`);
    map.fitBounds([tile.corners[0], tile.corners[2]], { maxZoom: 19, animate: false });
    showTile(tile.corners[2], tile);
  } else if (sought.fix !== undefined) {
    const fix = meantFix(state.fixes, sought.fix);
    if (fix) choose(fix);
    else say(state.fixes.length ? 'No such fix is among the last ones.' : 'No fixes are known here.');
  } else {
    await findId(sought.id);
  }
}

const CONTRIBUTOR = /^[0-9a-f]{16}$/;
const UPLOAD = /^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$/;

async function findId(id) {
  if (operates() && CONTRIBUTOR.test(id)) {
    await contributors.open(id);
    return openPart('contributors');
  }
  const kept = state.quarantine.uploads.find(({ upload_id, contributor }) => [upload_id, contributor].includes(id));
  const upload = state.uploads.find(({ upload_id }) => upload_id === id);
  if (kept) {
    openPart('quarantine');
    goTo(kept);
    return say(`In quarantine: ${kept.reason.toLowerCase()}, epoch ${kept.epoch}.`);
  }
  if (operates() && UPLOAD.test(id)) {
    const known = await ask(`api/v1/uploads/${id}`).catch((error) => (error.status === 404 ? undefined : Promise.reject(error)));
    if (known) return tellUpload(known);
  }
  const event = state.history.events.find(({ of, first, last }) => of === id || (upload?.epoch && upload.epoch >= first && upload.epoch <= last));
  if (upload) return say(`Upload ${id}: ${upload.outcome.toLowerCase().replaceAll('_', ' ')}, epoch ${upload.epoch}.`);
  if (event) {
    openPart('history');
    return say(`Decided about in epoch ${event.last}.`);
  }
  say('Nothing of this name is among the last uploads, in quarantine or in the history.');
}

/** What became of an upload; where it lies on the map, the difference that it made shows. */
function tellUpload({ upload_id, outcome, epoch, date, contributor }) {
  const of = `Upload ${upload_id}${contributor ? ` of contributor ${contributor}` : ''}: ${words(outcome)}, ${date}, epoch ${epoch}.`;
  const made = async () => {
    const change = await ask(`api/v1/map/diff?from=${epoch - 1}&to=${epoch}`);
    drawDifference(map, change);
    if (!change.tiles.length) return say(`${of} It changed nothing.`);
    const corners = change.tiles.flatMap((tile) => tile.corners ?? []);
    const [lons, lats] = [0, 1].map((axis) => corners.map((corner) => corner[axis]));
    frame(map, { bounds: [Math.min(...lons), Math.min(...lats), Math.max(...lons), Math.max(...lats)], center: corners[0] });
  };
  say(of, outcome === 'QUARANTINED' ? [] : ['Show what it changed', quietly(made)]);
}

const epochQuery = (before = '?') => (state.epoch === undefined ? '' : `${before}epoch=${state.epoch}`);

function quietly(work) {
  return (...args) => work(...args).catch((error) => {
    console.warn(error.message);
    say(error.message);
  });
}
function grow() {
  showRates(state.fixes);
  showAges();
  drawFixes(map, state.fixes);
}
const redraw = gathered(() => {
  showFixes(state.fixes, choose);
  showUploads(state.uploads, state.filter, openUpload);
  grow();
}, 120);
const newMap = gathered(quietly(async () => {
  await Promise.all([loadMap(), loadDecisions(), loadContributors()]);
  refresh(map, state.layer);
}), 1000);

const decisionsChanged = gathered(quietly(loadDecisions), 1000);

// What is clicked: a fix, or a tile and its cell.

let popup;
function open(at, content) {
  popup?.remove();
  const before = document.activeElement;
  popup = new Popup({ maxWidth: '320px', offset: 14 }).setLngLat(at).setDOMContent(content).addTo(map);
  popup.on('close', () => {
    outline(map, undefined);
    // The keyboard goes back to where it came from.
    if (document.activeElement === document.body && before?.isConnected) before.focus();
  });
}

function choose(fix) {
  const at = [fix.longitude_deg, fix.latitude_deg];
  map.easeTo({ center: at, zoom: Math.max(map.getZoom(), 18), animate: !calm.matches });
  open(at, fixDetails(fix));
}

/** An upload of the feed: what is in quarantine lies somewhere. */
function openUpload(upload) {
  byId('sought').value = upload.upload_id;
  quietly(findId)(upload.upload_id);
}

function showTile(at, tile, found) {
  const details = tileDetails(tile);
  if (found?.cell) details.append(cellDetails(found));
  open(at, details);
  outline(map, tile);
}

function near(point) {
  if (!point) return undefined;
  const around = [[point.x - 6, point.y - 6], [point.x + 6, point.y + 6]];
  return map.queryRenderedFeatures(around, { layers: ['kept', 'fix'] })[0];
}

async function chooseAt({ point, lngLat }) {
  const hit = near(point);
  if (hit?.layer.id === 'kept') {
    openPart('quarantine');
    return say(`In quarantine, epoch ${hit.properties.epoch}.`);
  }
  if (hit) {
    const fix = state.fixes[hit.properties.index];
    return open([fix.longitude_deg, fix.latitude_deg], fixDetails(fix));
  }
  await inspect(lngLat);
}

/** The tile at a position, and the cell that was hit there or within a few pixels. */
async function inspect(lngLat) {
  const here = `lat=${lngLat.lat.toFixed(7)}&lon=${wrapped(lngLat.lng).toFixed(7)}`;
  const none = (error) => (error.status === 404 ? undefined : Promise.reject(error));
  try {
    const [tile, found] = await Promise.all([
      ask(`api/v1/tiles/at?${here}${epochQuery('&')}`).catch(none),
      ask(`api/v1/cells/at?${here}&within_m=${withinPixels(lngLat.lat).toFixed(2)}${epochQuery('&')}`).catch(none),
    ]);
    if (tile) showTile(lngLat, tile, found);
    else if (found) open(lngLat, waitingDetails(found));
    else popup?.remove();
  } catch (error) {
    popup?.remove();
    console.warn(error.message);
  }
}

/** A tile of which nothing is served yet: operators are told of it. */
const waitingDetails = (found) =>
  el('article', { className: 'details' },
    el('h3', { textContent: `Tile ${found.tile}` }),
    el('p', { textContent: 'Nothing of it is served yet.' }),
    found.cell ? cellDetails(found) : null);

/** Six pixels of the map in metres, as far as the service seeks a cell. */
const withinPixels = (lat) => Math.min(5, (6 * 40_075_017 * Math.cos((lat * Math.PI) / 180)) / (512 * 2 ** map.getZoom()));

/** A longitude of whichever copy of the world, from -180 to 180. */
const wrapped = (lng) => ((((lng + 180) % 360) + 360) % 360) - 180;

document.addEventListener('keydown', ({ key }) => key === 'Escape' && !document.querySelector('dialog[open]') && popup?.remove());

// What happens.

map.once('load', () => {
  addRadar(map);
  addFixes(map);
  addDifference(map);
  addQuarantine(map);
  showLayer(map, state.layer);
  quietly(addBase)(map, LAYERS[0]);
  drawQuarantine(map, state.quarantine);
  document.body.dataset.ready = 'true';
  map.on('click', chooseAt);
  // By the keyboard: what lies in the middle of the map.
  map.getCanvas().addEventListener('keydown', ({ key }) => key === 'Enter' && quietly(inspect)(map.getCenter()));
  map.on('mouseenter', 'fix', () => (map.getCanvas().style.cursor = 'pointer'));
  map.on('mouseleave', 'fix', () => (map.getCanvas().style.cursor = ''));
  redraw();
  // Fixes fade and ages grow also when nothing happens.
  setInterval(() => document.hidden || grow(), 1000);
});

/** An upload, with what vetting said of it. */
function marked(upload) {
  const known = [...state.kept, ...state.quarantine.uploads];
  const kept = upload.epoch && known.find(({ epoch }) => epoch === upload.epoch);
  return kept ? { ...upload, outcome: 'QUARANTINED', kept } : upload;
}

follow({
  open() {
    showStream('live');
    quietly(loadMap)();
    quietly(loadFeeds)();
    quietly(loadDecisions)();
  },
  lost() {
    showStream('lost');
    showStale();
    // A stream does not say why it is refused; this does, and asks for a sign-in if that is it.
    ask('api/v1/map').catch(() => {});
  },
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
    decisionsChanged();
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
byId('filter').addEventListener('change', ({ currentTarget }) => {
  state.filter = currentTarget.value;
  showUploads(state.uploads, state.filter, openUpload);
});
byId('search').addEventListener('submit', (event) => {
  event.preventDefault();
  quietly(() => find(byId('sought').value))();
});
byId('fit').addEventListener('click', () => state.whole && frame(map, state.whole));
const openPart = tabs((part) => quietly({ contributors: loadContributors }[part] ?? loadDecisions)());
const asked = new URLSearchParams(location.hash.slice(1)).get('layer');
quietly(() => chooseLayer(LAYERS.includes(asked) ? asked : 'evidence'))();
