// The map of another epoch, and how two epochs differ.

import { byId } from './dom.js';
import { count } from './format.js';

/** `change` is called with the epoch to show, undefined for the newest; `compare` with whether to show the difference. */
export function timeControls(change, compare) {
  const [slider, now, box] = [byId('epoch'), byId('epoch-now'), byId('compare')];
  let range = { oldest: 0, newest: 0 };
  let shown;
  const show = (epoch) => {
    shown = epoch !== undefined && epoch < range.newest ? Math.max(epoch, range.oldest) : undefined;
    slider.value = String(shown ?? range.newest);
    byId('epoch-shown').value = shown === undefined ? `epoch ${range.newest}, now` : `epoch ${shown} of ${range.newest}`;
    slider.setAttribute('aria-valuetext', byId('epoch-shown').value);
    now.disabled = shown === undefined;
    box.disabled = shown === undefined;
    if (shown === undefined) box.checked = false;
    document.body.classList.toggle('past', shown !== undefined);
  };
  slider.addEventListener('input', () => show(Number(slider.value)));
  slider.addEventListener('change', () => {
    change(shown);
    compare(box.checked ? shown : undefined);
  });
  now.addEventListener('click', () => {
    show(undefined);
    change(undefined);
    compare(undefined);
  });
  box.addEventListener('change', () => compare(box.checked ? shown : undefined));
  return {
    range({ oldest, newest }) {
      range = { oldest, newest };
      slider.min = String(oldest);
      slider.max = String(newest);
      byId('time').hidden = newest === 0;
      show(shown);
    },
    to(epoch) {
      show(epoch);
      change(shown);
    },
  };
}

export function addDifference(map) {
  map.addSource('difference', { type: 'geojson', data: { type: 'FeatureCollection', features: [] } });
  map.addLayer({
    id: 'difference', type: 'fill', source: 'difference',
    paint: { 'fill-color': ['match', ['get', 'more'], 'added', '#7df0a8', 'removed', '#ff6b7a', '#ffc14d'], 'fill-opacity': 0.28, 'fill-outline-color': '#ffffff' },
  });
}

/** Tiles that differ: green where cells were added, red where they were removed, amber where they only changed. */
export function drawDifference(map, change) {
  const feature = ({ added, removed, corners }) => {
    const more = added > removed ? 'added' : removed > 0 ? 'removed' : 'changed';
    return { type: 'Feature', properties: { more }, geometry: { type: 'Polygon', coordinates: [[...corners, corners[0]]] } };
  };
  const features = (change?.tiles ?? []).filter(({ corners }) => corners).map(feature);
  map.getSource('difference')?.setData({ type: 'FeatureCollection', features });
  const note = byId('difference-note');
  note.hidden = !change;
  if (change) {
    const { cells, tiles_changed } = change;
    note.textContent = `${count(cells.added)} cells added, ${count(cells.removed)} removed, ${count(cells.changed)} changed in ${count(tiles_changed)} tiles`;
  }
}
