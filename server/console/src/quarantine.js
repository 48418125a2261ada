// What vetting kept out of the map, and what several contributors agree on: a list, and arrows on the map.

import { byId, el, fill } from './dom.js';
import { deciding } from './decide.js';
import { words } from './format.js';

const EMPTY = { type: 'FeatureCollection', features: [] };
/** Of the earth, for offsets of some metres. */
const M_PER_DEG = 111_195;

/** Where an offset leads from a place. */
function moved({ lat, lon }, { east_m, north_m }) {
  return [lon + east_m / (M_PER_DEG * Math.cos((lat * Math.PI) / 180)), lat + north_m / M_PER_DEG];
}

export function addQuarantine(map) {
  map.addSource('quarantine', { type: 'geojson', data: EMPTY });
  map.addLayer({
    id: 'alarm', type: 'circle', source: 'quarantine', filter: ['==', 'kind', 'alarm'],
    paint: { 'circle-radius': 26, 'circle-color': '#ff6b7a', 'circle-opacity': 0.12, 'circle-stroke-color': '#ff6b7a', 'circle-stroke-width': 2 },
  });
  map.addLayer({
    id: 'kept-line', type: 'line', source: 'quarantine', filter: ['==', '$type', 'LineString'],
    paint: { 'line-color': '#ffc14d', 'line-width': 2.5 },
  });
  map.addLayer({
    id: 'kept', type: 'circle', source: 'quarantine', filter: ['==', 'kind', 'kept'],
    paint: { 'circle-radius': 5, 'circle-color': '#ffc14d', 'circle-stroke-color': '#05080d', 'circle-stroke-width': 1.5 },
  });
  map.addLayer({
    id: 'kept-way', type: 'symbol', source: 'quarantine', filter: ['==', 'kind', 'way'],
    layout: { 'icon-image': 'arrow', 'icon-size': 0.55, 'icon-rotate': ['get', 'bearing_deg'], 'icon-rotation-alignment': 'map', 'icon-allow-overlap': true },
    paint: { 'icon-color': '#ffc14d', 'icon-halo-color': '#05080d', 'icon-halo-width': 1.6 },
  });
}

const point = (coordinates, properties) => ({ type: 'Feature', properties, geometry: { type: 'Point', coordinates } });

/** Draws each upload where it is, and an arrow to where it would lie on the map. */
export function drawQuarantine(map, { uploads, alarms }) {
  const placed = uploads.slice(0, 500).filter(({ place }) => place);
  const features = placed.flatMap(({ place, offset, epoch }) => {
    const at = [place.lon, place.lat];
    if (!offset) return [point(at, { kind: 'kept', epoch })];
    const to = moved(place, offset);
    const bearing_deg = (Math.atan2(offset.east_m, offset.north_m) * 180) / Math.PI;
    const line = { type: 'Feature', properties: { kind: 'line' }, geometry: { type: 'LineString', coordinates: [at, to] } };
    return [line, point(at, { kind: 'kept', epoch }), point(to, { kind: 'way', bearing_deg })];
  });
  const rings = alarms.filter(({ place }) => place).map(({ place }) => point([place.lon, place.lat], { kind: 'alarm' }));
  map.getSource('quarantine')?.setData({ type: 'FeatureCollection', features: [...rings, ...features] });
}

const metres = ({ east_m, north_m }) =>
  `${Math.abs(east_m).toFixed(2)} m ${east_m < 0 ? 'west' : 'east'}, ${Math.abs(north_m).toFixed(2)} m ${north_m < 0 ? 'south' : 'north'}`;

/** `go` is called with an entry, `revoke` with what to revoke and its words. */
export function showQuarantine({ quarantined, uploads, alarms }, { go, revoke }) {
  byId('quarantine-count').textContent = quarantined || alarms.length ? String(quarantined) : '';
  byId('quarantine-count').dataset.tone = alarms.length ? 'bad' : 'wait';
  const alarm = (of) =>
    el('li', { className: 'entry alarm' },
      el('button', { type: 'button', className: 'go', onclick: () => go(of) },
        el('b', { textContent: `Alarm: ${of.contributors} contributors agree` }),
        el('span', { textContent: of.offset ? `the map seems shifted: ${metres(of.offset)}` : 'they see something else than the map' }),
        el('span', { textContent: `since ${of.since}` })));
  const one = (of) =>
    el('li', { className: 'entry' },
      el('button', { type: 'button', className: 'go', onclick: () => go(of) },
        el('b', { textContent: `${words(of.reason)}${of.offset_m == null ? '' : ` by ${of.offset_m.toFixed(2)} m`}` }),
        el('span', { textContent: `${of.offset ? `belongs ${metres(of.offset)}` : 'shows something else than the map'}` }),
        el('span', { textContent: `${of.date} · epoch ${of.epoch}` })),
      el('dl', { className: 'ids' },
        el('div', {}, el('dt', { textContent: 'upload' }), el('dd', { textContent: of.upload_id ?? 'compacted' })),
        el('div', {}, el('dt', { textContent: 'contributor' }), el('dd', { textContent: of.contributor ?? 'told to operators' }))),
      el('p', { className: 'acts' },
        of.upload_id ? deciding('Revoke upload', `Revoke upload ${of.upload_id}`, () => revoke({ upload: of.upload_id }, `Revoke upload ${of.upload_id}?`)) : null,
        of.contributor ? deciding('Revoke contributor', `Revoke contributor ${of.contributor}, epoch ${of.epoch}`, () =>
          revoke({ contributor_hash: of.contributor }, `Revoke all uploads so far of contributor ${of.contributor}?`)) : null));
  const none = el('li', { className: 'none', textContent: 'Nothing is in quarantine.' });
  const rows = [...alarms.map(alarm), ...uploads.slice(0, 100).map(one)];
  fill(byId('quarantine'), rows.length ? rows : [none]);
  byId('quarantine-note').textContent = uploads.length > 100 ? `the newest 100 of ${quarantined}` : '';
}
