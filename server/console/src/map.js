// The map: radar layers on a dark ground.

import { AttributionControl, Map, NavigationControl, ScaleControl, setWorkerUrl } from 'maplibre-gl';
import { byId, calm } from './dom.js';
import { position } from './format.js';
import { addGraticule } from './graticule.js';

/** Where the service is: a proxy may show it below a path. */
export const HERE = new URL('.', document.baseURI).href;

setWorkerUrl(HERE + WORKER_URL);

/** The radar layers and the first zoom that shows each. */
const FROM_ZOOM = { evidence: 0, coverage: 0, age: 0, localizability: 16 };
export const LAYERS = Object.keys(FROM_ZOOM);
const GROUND = '#070b12';
/** A map wider than this is shown at its densest part instead of as a whole, degrees. */
const WIDE = 0.5;

/** A link whose view is none is forgotten: the map then shows what there is. */
export function forgetBadView() {
  const hash = new URLSearchParams(location.hash.slice(1));
  const view = hash.get('view');
  if (view === null) return;
  const [zoom, lat, lng, ...rest] = view.split('/').map((part) => (part.trim() === '' ? NaN : Number(part)));
  const sane = zoom >= 0 && zoom <= 24 && Math.abs(lat) <= 90 && Math.abs(lng) <= 720 && rest.every(Number.isFinite);
  if (sane) return;
  hash.delete('view');
  history.replaceState(null, '', `#${hash}`);
}

export function createMap() {
  const map = new Map({
    container: 'map',
    style: { version: 8, sources: {}, layers: [{ id: 'ground', type: 'background', paint: { 'background-color': GROUND } }] },
    center: [0, 25],
    zoom: 1.6,
    maxZoom: 22,
    hash: 'view',
    attributionControl: false,
    // North stays up, so that the net of degrees stays straight.
    dragRotate: false,
    touchPitch: false,
    pitchWithRotate: false,
    fadeDuration: 0,
    // Services of tiles ask to be told by which page they are used; our own is told nothing.
    transformRequest: (url) => (new URL(url, HERE).origin === location.origin ? { url } : { url, referrerPolicy: 'strict-origin-when-cross-origin' }),
  });
  map.touchZoomRotate.disableRotation();
  map.keyboard.disableRotation();
  map.addControl(new NavigationControl({ showCompass: false }), 'bottom-right');
  map.addControl(new ScaleControl({ maxWidth: 160 }), 'bottom-right');
  map.addControl(new AttributionControl({ compact: false }), 'bottom-right');
  addGraticule(map);
  const where = byId('where');
  map.on('mousemove', ({ lngLat: { lng, lat } }) => (where.value = position(lng, lat)));
  map.on('mouseout', () => (where.value = ''));
  return map;
}

/** Adds the radar layers, all hidden. */
export function addRadar(map) {
  for (const layer of LAYERS) {
    map.addSource(layer, {
      type: 'raster',
      tiles: [address(layer)],
      tileSize: 256,
      minzoom: FROM_ZOOM[layer],
      maxzoom: 22,
      attribution: 'Echofix radar map',
    });
    map.addLayer({
      id: layer,
      type: 'raster',
      source: layer,
      layout: { visibility: 'none' },
      paint: { 'raster-fade-duration': calm.matches ? 0 : 180 },
    });
  }
}

export function showLayer(map, shown) {
  for (const layer of LAYERS) {
    map.setLayoutProperty(layer, 'visibility', layer === shown ? 'visible' : 'none');
  }
}

/** The map as it was at an epoch; undefined for now. */
export function showEpoch(map, epoch, shown) {
  const query = epoch === undefined ? '' : `?epoch=${epoch}`;
  for (const layer of LAYERS) map.getSource(layer)?.setTiles([address(layer, query)]);
  refresh(map, shown);
}

const address = (layer, query = '') => `${HERE}tiles/${layer}/{z}/{x}/{y}{ratio}.png${query}`;

/** Asks again for the tiles in view; unchanged ones cost a short answer. */
export function refresh(map, shown) {
  for (const layer of LAYERS) if (layer === shown) map.refreshTiles(layer);
}

/** Goes where there is something to see, unless the address says where to look. */
export function frame(map, { bounds, center }) {
  if (!bounds) return;
  const [west, south, eastward, north] = bounds;
  // Across the date line a box ends in the next world.
  const east = eastward < west ? eastward + 360 : eastward;
  const panel = byId('panel').getBoundingClientRect();
  const beside = matchMedia('(min-width: 48rem)').matches;
  const padding = beside
    ? { left: panel.right + 40, right: 60, top: 60, bottom: 60 }
    : { left: 20, right: 20, top: 120, bottom: window.innerHeight - panel.top + 20 };
  if (Math.max(east - west, north - south) < WIDE) {
    map.fitBounds([west, south, east, north], { padding, maxZoom: 18, animate: false });
  } else {
    map.jumpTo({ center, zoom: 15 });
  }
}
