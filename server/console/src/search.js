// What is typed into the search: a position, a tile, a fix, an upload or a contributor.

import { families } from './verdicts.js';

const POSITION = /^\s*(-?\d+(?:\.\d+)?)\s*°?\s*([NS])?[\s,;]+(-?\d+(?:\.\d+)?)\s*°?\s*([EW])?\s*$/i;
const STATUSES = families.flatMap(({ statuses }) => statuses);
const constant = (words) => words.trim().toUpperCase().replaceAll(' ', '_');
const TILE = /^\s*(\d{5})\/(-?\d+)\/(-?\d+)\s*$/;

/** What a text means: `{ lat, lon }`, `{ tile }`, `{ fix }` or `{ id }`; undefined when nothing is typed. */
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
  const fix = /^fix\b\s*(.*)$/.exec(id)?.[1] ?? (STATUSES.includes(constant(id)) ? id : undefined);
  if (fix !== undefined) return { fix };
  return id ? { id } : undefined;
}

/** The fix that words name: the newest, a number from the newest on, or the newest with a status. */
export function meantFix(fixes, words) {
  if (!words) return fixes[0];
  return /^\d+$/.test(words) ? fixes[Number(words) - 1] : fixes.find(({ status }) => status === constant(words));
}
