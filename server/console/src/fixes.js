// Fixes on the map: an arrow at the corrected pose, a thin line to the prior, fading with age.

import { el } from './dom.js';
import { ago, figure, percent, position, words } from './format.js';
import { families, familyOf } from './verdicts.js';

/** A fix is at full strength for so long, then fades until it is old. */
const FRESH_S = 4;
const OLD_S = 120;
const FAINTEST = 0.22;
const EMPTY = { type: 'FeatureCollection', features: [] };

const color = ['match', ['get', 'family'], ...families.flatMap((f) => [f.name, f.color]), '#fff'];

export function addFixes(map) {
  map.addImage('arrow', arrow(), { sdf: true, pixelRatio: 2 });
  map.addSource('fixes', { type: 'geojson', data: EMPTY });
  map.addSource('chosen', { type: 'geojson', data: EMPTY });
  const strength = ['get', 'strength'];
  const byZoom = (far, near) => ['interpolate', ['exponential', 1.5], ['zoom'], 12, far, 19, near];
  map.addLayer({
    id: 'fix-glow', type: 'circle', source: 'fixes', filter: ['all', ['==', '$type', 'Point'], ['>', 'strength', 0.95]],
    paint: { 'circle-color': color, 'circle-radius': byZoom(9, 26), 'circle-blur': 1, 'circle-opacity': 0.42 },
  });
  map.addLayer({
    id: 'fix-line', type: 'line', source: 'fixes', filter: ['==', '$type', 'LineString'],
    paint: { 'line-color': color, 'line-width': byZoom(0.6, 1.6), 'line-opacity': ['*', 0.8, strength] },
  });
  map.addLayer({
    id: 'fix', type: 'symbol', source: 'fixes', filter: ['==', '$type', 'Point'],
    layout: {
      'icon-image': 'arrow', 'icon-size': byZoom(0.36, 1.15), 'icon-rotate': ['get', 'bearing_deg'],
      'icon-rotation-alignment': 'map', 'icon-allow-overlap': true, 'icon-ignore-placement': true,
      'symbol-sort-key': ['get', 'strength'],
    },
    paint: {
      'icon-color': color, 'icon-opacity': strength, 'icon-halo-color': '#05080d', 'icon-halo-width': 1.6,
    },
  });
  map.addLayer({
    id: 'chosen', type: 'line', source: 'chosen',
    paint: { 'line-color': '#ffffff', 'line-width': 1.4, 'line-opacity': 0.9 },
  });
}

/** Shows the fixes as they are at this moment. */
export function drawFixes(map, fixes) {
  map.getSource('fixes')?.setData({ type: 'FeatureCollection', features: fixes.flatMap(features) });
}

function features(fix, index) {
  const at = [fix.longitude_deg, fix.latitude_deg];
  const prior = [fix.prior_longitude_deg, fix.prior_latitude_deg];
  const age_s = Date.now() / 1000 - fix.answered_us / 1e6;
  const faded = Math.min(Math.max((age_s - FRESH_S) / (OLD_S - FRESH_S), 0), 1);
  const properties = {
    index,
    family: familyOf(fix.status).name,
    strength: 1 - (1 - FAINTEST) * faded ** 0.6,
    // Yaw is counter-clockwise from east, a bearing clockwise from north.
    bearing_deg: 90 - (fix.yaw_rad * 180) / Math.PI,
  };
  const feature = (type, coordinates) => ({ type: 'Feature', properties, geometry: { type, coordinates } });
  return [feature('LineString', [prior, at]), feature('Point', at)];
}

/** What there is to know about a fix. */
export function fixDetails(fix) {
  const family = familyOf(fix.status);
  const row = (term, value) => el('div', {}, el('dt', { textContent: term }), el('dd', { textContent: value }));
  const title = el('h3', { textContent: words(fix.status) });
  title.style.color = family.color;
  return el(
    'article', { className: 'details' },
    title,
    el('p', { textContent: fix.reason }),
    el(
      'dl', {},
      row('correction', `${figure(fix.correction_m)} m`),
      row('matched', percent(fix.matched_fraction)),
      row('protection', fix.protection_m == null ? 'not valid' : `${figure(fix.protection_m)} m`),
      row('aligned in', `${figure(fix.align_ms)} ms`),
      row('answered', `${ago(fix.answered_us)} ago`.replace('now ago', 'just now')),
      row('position', position(fix.longitude_deg, fix.latitude_deg)),
    ),
  );
}

/** What there is to know about a tile. */
export function tileDetails(tile) {
  const most = Math.max(...tile.passes.map(({ cells }) => cells), 1);
  const bars = tile.passes.slice(0, 8).map(({ passes, cells }) => {
    const bar = el('span', { className: 'bar' });
    bar.style.width = `${(70 * cells) / most}%`;
    return el('div', {}, el('dt', { textContent: `${passes} ${passes === 1 ? 'pass' : 'passes'}` }), el('dd', {}, bar, `${cells}`));
  });
  const row = (term, value) => el('div', {}, el('dt', { textContent: term }), el('dd', { textContent: value }));
  return el(
    'article', { className: 'details' },
    el('h3', { textContent: `Tile ${tile.id}` }),
    el(
      'dl', {},
      row('cells', `${tile.cells.toLocaleString('en')}`),
      row('seen', tile.oldest_date === tile.newest_date ? `${tile.newest_date}` : `${tile.oldest_date} to ${tile.newest_date}`),
      row('changed', `epoch ${tile.version}`),
      row('size', `${figure(tile.bytes / 1000)} kB`),
    ),
    el('dl', { className: 'bars' }, ...bars),
  );
}

/** What there is to know about a cell of it: `cell` as the service tells it. */
export function cellDetails({ cell, needed, distance_m }) {
  const row = (term, value) => el('div', {}, el('dt', { textContent: term }), el('dd', { textContent: value }));
  const served = cell.standing === 'SERVED';
  const dates = cell.first_date === cell.last_date ? cell.first_date : `${cell.first_date} to ${cell.last_date}`;
  const hashes = cell.contributor_hashes ?? [];
  return el(
    'section', { className: 'cell', ariaLabel: 'Cell' },
    el('h4', { textContent: `Cell ${cell.column}, ${cell.row}` }, el('small', { textContent: ` ${figure(distance_m)} m away` })),
    el('p', { className: served ? 'served' : 'withheld', textContent: `${served ? 'Served' : 'Not served'}: ${cell.reason}` }),
    el(
      'dl', {},
      row('hits', String(cell.hits)),
      row('passes', `${cell.passes} of ${cell.observed} in view`),
      row('presence', percent(cell.presence)),
      row('seen', dates),
      row('contributors', `${cell.contributors}, ${cell.support} within 0.4 m, ${needed} needed`),
    ),
    hashes.length ? el('ul', { className: 'hashes', ariaLabel: 'Contributors lately' }, ...hashes.map((textContent) => el('li', { textContent }))) : null,
  );
}

/** Outlines a tile. */
export function outline(map, tile) {
  const coordinates = tile ? [...tile.corners, tile.corners[0]] : [];
  const feature = { type: 'Feature', properties: {}, geometry: { type: 'LineString', coordinates } };
  map.getSource('chosen')?.setData(tile ? feature : EMPTY);
}

/** A navigation arrow as a signed-distance image. */
function arrow() {
  const side = 64;
  const canvas = Object.assign(document.createElement('canvas'), { width: side, height: side });
  const pen = canvas.getContext('2d');
  pen.fillStyle = '#fff';
  pen.filter = 'blur(1.5px)';
  pen.beginPath();
  pen.moveTo(32, 10);
  pen.lineTo(49, 51);
  pen.lineTo(32, 42);
  pen.lineTo(15, 51);
  pen.closePath();
  pen.fill();
  return pen.getImageData(0, 0, side, side);
}
