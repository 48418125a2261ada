// What is typed into the search: a position, a tile, an upload or a contributor.

const POSITION = /^\s*(-?\d+(?:\.\d+)?)\s*°?\s*([NS])?[\s,;]+(-?\d+(?:\.\d+)?)\s*°?\s*([EW])?\s*$/i;
const TILE = /^\s*(\d{5})\/(-?\d+)\/(-?\d+)\s*$/;

/** What a text means: `{ lat, lon }`, `{ tile }` or `{ id }`; undefined when nothing is typed. */
export function meant(text) {
  const place = POSITION.exec(text);
  if (place) {
    const lat = Number(place[1]) * (/s/i.test(place[2] ?? '') ? -1 : 1);
    const lon = Number(place[3]) * (/w/i.test(place[4] ?? '') ? -1 : 1);
    if (Math.abs(lat) <= 90 && Math.abs(lon) <= 180) return { lat, lon };
  }
  const tile = TILE.exec(text);
  if (tile) return { tile: tile.slice(1).join('/') };
  const id = text.trim().toLowerCase();
  return id ? { id } : undefined;
}
