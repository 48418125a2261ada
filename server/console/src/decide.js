// A decision is told beforehand, asked for with its reason, and only then taken.

import { byId, el, numbers } from './dom.js';
import { count } from './format.js';
import { post } from './service.js';

/** Asks about a decision; resolves with the service's answer, or with nothing when it was not taken. */
export async function decide(title, route, body, { preview } = {}) {
  const dialog = byId('decide');
  byId('decide-title').textContent = title;
  byId('decide-note').textContent = 'Looking at what this would change …';
  byId('decide-numbers').replaceChildren();
  const confirm = byId('decide-yes');
  confirm.disabled = true;
  byId('decide-reason').value = '';
  dialog.showModal();
  try {
    const { dry_run: change } = await post(`api/v1/map/${route}`, { ...body, dry_run: true });
    tell(change);
    preview?.(change);
    confirm.disabled = false;
  } catch (error) {
    byId('decide-note').textContent = error.message;
  }
  const said = await new Promise((resolve) => dialog.addEventListener('close', () => resolve(dialog.returnValue), { once: true }));
  preview?.(undefined);
  if (said !== 'yes') return undefined;
  return post(`api/v1/map/${route}`, { ...body, reason: byId('decide-reason').value });
}

function tell(change) {
  const { uploads, imported_tiles: tiles, cells } = change;
  numbers(byId('decide-numbers'), [
    ['uploads taken back', count(uploads.taken_back)],
    ['uploads given back', count(uploads.given_back)],
    ['contributors', count(change.contributors)],
    ['cells removed', count(cells.removed)],
    ['cells added', count(cells.added)],
    ['cells changed', count(cells.changed)],
    ['tiles', count(change.tiles_changed)],
    ['imported tiles', count(tiles.taken_back + tiles.given_back)],
    ['compacted', count(change.compacted)],
  ]);
  byId('decide-note').textContent = change.can_be_undone
    ? 'The history lists it, and it can be undone there.'
    : 'What is compacted can be neither taken back nor brought back. This cannot be undone.';
}

/** A button that begins a decision. */
export const deciding = (text, label, onclick) =>
  el('button', { type: 'button', className: 'act deciding', textContent: text, ariaLabel: label, onclick });
