// The map of streets below the radar map, where the service has one: tiles of another service, or a PMTiles file of this one.

import { addProtocol } from 'maplibre-gl';
import { PMTiles, Protocol, TileType } from 'pmtiles';
import { byId } from './dom.js';
import { HERE } from './map.js';
import { ask } from './service.js';

/** Pictures are dimmed: the radar map is drawn for a dark ground, and lies above. */
const DIMMED = { 'raster-opacity': 0.45, 'raster-saturation': -0.6, 'raster-brightness-max': 0.75, 'raster-fade-duration': 0 };
/** Lines and areas of vector tiles, whatever they stand for. */
const AREA = { 'fill-color': '#16202e', 'fill-opacity': 0.55 };
const LINE = { 'line-color': '#3b5068', 'line-width': ['interpolate', ['exponential', 1.6], ['zoom'], 10, 0.5, 18, 5] };

/** Adds what the service has, below all else. */
export async function addBase(map, below) {
  const base = await ask('base-map');
  if (base.kind === 'NONE') return;
  const { source, layers } = base.kind === 'PMTILES' ? await ofFile(HERE + base.url) : ofTiles(base);
  const attribution = linked(base.attribution || source.attribution || '');
  map.addSource('base', { ...source, attribution });
  for (const layer of layers) map.addLayer({ ...layer, id: `base-${layer.id}`, source: 'base' }, below);
  const shown = byId('base');
  const show = () => {
    for (const { id } of layers) map.setLayoutProperty(`base-${id}`, 'visibility', shown.checked ? 'visible' : 'none');
  };
  shown.addEventListener('change', show);
  byId('base-choice').hidden = false;
  show();
}

const picture = { id: 'picture', type: 'raster', paint: DIMMED };

const ofTiles = ({ url, max_zoom }) => ({
  source: { type: 'raster', tiles: [url], tileSize: 256, maxzoom: max_zoom },
  layers: [picture],
});

async function ofFile(address) {
  const protocol = new Protocol();
  const file = new PMTiles(address);
  protocol.add(file);
  addProtocol('pmtiles', protocol.tile);
  const { tileType, minZoom, maxZoom, minLon, minLat, maxLon, maxLat } = await file.getHeader();
  const { vector_layers: within = [], attribution } = await file.getMetadata();
  const common = {
    tiles: [`pmtiles://${address}/{z}/{x}/{y}`], minzoom: minZoom, maxzoom: maxZoom, bounds: [minLon, minLat, maxLon, maxLat],
    attribution: attribution && new DOMParser().parseFromString(attribution, 'text/html').body.textContent,
  };
  if (tileType !== TileType.Mvt) return { source: { ...common, type: 'raster', tileSize: 256 }, layers: [picture] };
  const of = (kind, type, paint) =>
    within.map(({ id }) => ({ id: `${type}-${id}`, type, 'source-layer': id, filter: ['==', ['geometry-type'], kind], paint }));
  return { source: { ...common, type: 'vector' }, layers: [...of('Polygon', 'fill', AREA), ...of('LineString', 'line', LINE)] };
}

/** Plain words as the markup that the map wants; addresses in them become links. */
function linked(words) {
  const line = document.createElement('span');
  for (const part of words.split(/(https:\/\/[^\s<>"']+)/)) {
    const link = part.startsWith('https://') && Object.assign(document.createElement('a'), { href: part, rel: 'noreferrer', target: '_blank' });
    if (link) link.textContent = link.host || part;
    line.append(link || part);
  }
  return line.innerHTML;
}
