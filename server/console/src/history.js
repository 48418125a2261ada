// What happened to the map, and what was decided about it.

import { byId, el, fill } from './dom.js';
import { deciding } from './decide.js';
import { count } from './format.js';

const KINDS = {
  revoke_contributor: (of) => `contributor ${of ?? ''} revoked`,
  revoke_upload: (of) => `upload ${of} revoked`,
  rollback: (of) => `rolled back to epoch ${of}`,
  undo: (of) => `decision ${of} undone`,
  settle: (of) => `compacted up to record ${of}`,
};

function what(event) {
  if (event.kind === 'uploads') return `${count(event.uploads)} uploads of ${count(event.contributors)} contributors`;
  if (event.kind === 'import') return `${count(event.tiles)} tiles imported`;
  return KINDS[event.kind]?.(event.of) ?? event.kind;
}

function effect({ taken_back, takes_back, gives_back }) {
  if (taken_back) return `${count(taken_back)} of them taken back`;
  if (takes_back) return `takes back ${count(takes_back)}`;
  return gives_back ? `gives back ${count(gives_back)}` : '';
}

/** `look` is called with an epoch, `rollback` and `undo` with an event. */
export function showHistory({ events }, { look, rollback, undo }) {
  const row = (event) => {
    const epochs = event.first === event.last ? `epoch ${event.last}` : `epochs ${event.first} to ${event.last}`;
    const when = event.at_us ? new Date(event.at_us / 1000).toISOString().slice(0, 16).replace('T', ' ') : event.date;
    const said = [event.by && `by ${event.by}`, event.reason && `“${event.reason}”`, event.undone_by && `undone by ${event.undone_by}`];
    const undoable = ['rollback', 'revoke_contributor', 'revoke_upload', 'undo'].includes(event.kind) && !event.undone_by;
    return el('li', { className: 'entry' },
      el('button', { type: 'button', className: 'go', title: 'Look at the map of this epoch', onclick: () => look(event.last) },
        el('b', { textContent: what(event) }),
        el('span', { textContent: [effect(event), ...said].filter(Boolean).join(' · ') }),
        el('span', { textContent: `${when} · ${epochs}` })),
      el('p', { className: 'acts' },
        undoable ? deciding('Undo', `Undo decision ${event.last}`, () => undo(event)) : null,
        deciding('Roll back to here', `Roll back to here, epoch ${event.last}`, () => rollback(event))));
  };
  const none = el('li', { className: 'none', textContent: 'Nothing has happened yet.' });
  fill(byId('history'), events.length ? events.map(row) : [none]);
}
