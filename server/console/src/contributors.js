// Who contributes, by keyed hashes: a list, sorted and filtered by the service, and the uploads of each.

import { byId, el, fill } from './dom.js';
import { deciding } from './decide.js';
import { count, words } from './format.js';
import { ask } from './service.js';

/** Contributors that are listed at a time, and uploads of one. */
const PAGE = 50;
const UPLOADS = 20;

const TONES = { COUNTED: 'good', QUARANTINED: 'bad', TAKEN_BACK: 'wait' };

/** `find` is called with an upload's id, `revoke` with what to revoke and its words, `undo` with an event. */
export function contributorsPanel({ find, revoke, undo, failed }) {
  const [list, more, note, form] = ['contributors', 'contributors-more', 'contributors-note', 'contributors-form'].map(byId);
  let [known, found, opened, asked] = [[], 0, undefined, 0];

  async function load(from = 0) {
    const query = new URLSearchParams(new FormData(form));
    query.set('offset', String(from));
    query.set('limit', String(from ? PAGE : Math.max(PAGE, known.length)));
    // The last question counts, whichever is answered last.
    asked += 1;
    const mine = asked;
    const answer = await ask(`api/v1/contributors?${query}`);
    if (mine !== asked) return;
    known = from ? [...known, ...answer.contributors] : answer.contributors;
    found = answer.found;
    await show();
  }

  async function show() {
    const uploads = known.some(({ contributor }) => contributor === opened) ? await uploadsOf(opened) : undefined;
    const none = el('li', { className: 'none', textContent: 'None of these.' });
    fill(list, known.length ? known.map((of) => entry(of, of.contributor === opened ? uploads : undefined)) : [none]);
    more.hidden = known.length >= found;
    note.textContent = `${count(known.length)} of ${count(found)}`;
  }

  function entry(of, uploads) {
    const { contributor, revoked } = of;
    const figures = [[of.uploads, 'uploads'], [of.quarantined, 'in quarantine'], [of.taken_back, 'taken back']];
    const told = figures.filter(([number], i) => number || !i).map(([number, what]) => `${count(number)} ${number === 1 && what === 'uploads' ? 'upload' : what}`);
    const toggle = el('button', { type: 'button', className: 'go', onclick: () => open(uploads ? undefined : contributor), ariaExpanded: String(Boolean(uploads)) },
      el('b', { className: 'hash', textContent: contributor }),
      el('span', { textContent: told.join(' · ') }),
      el('span', { textContent: `last seen ${of.last_date} · epoch ${of.last_epoch}` }),
      revoked ? el('span', { className: 'revoked', textContent: ['revoked', revoked.by && `by ${revoked.by}`, revoked.reason && `“${revoked.reason}”`].filter(Boolean).join(' ') }) : null);
    return el('li', { className: 'entry' },
      toggle,
      uploads ?? null,
      el('p', { className: 'acts' },
        of.uploads > of.taken_back ? deciding('Revoke contributor', `Revoke contributor ${contributor}`, () =>
          revoke({ contributor_hash: contributor }, `Revoke all uploads so far of contributor ${contributor}?`)) : null,
        revoked ? deciding('Undo revocation', `Undo revocation of ${contributor}`, () => undo({ last: revoked.epoch })) : null));
  }

  async function uploadsOf(contributor) {
    const rows = el('ol', { className: 'rows', ariaLabel: `Uploads of ${contributor}` });
    const next = async (before) => {
      const answer = await ask(`api/v1/contributors/${contributor}/uploads?limit=${UPLOADS}${before ? `&before=${before}` : ''}`);
      rows.querySelector('.more')?.remove();
      rows.append(...answer.uploads.map((of) => el('li', {}, el('button', { type: 'button', title: of.upload_id ?? '', onclick: () => find(of) },
        el('i', { className: 'dot', data: { tone: TONES[of.outcome] } }),
        el('b', { textContent: words(of.outcome) }),
        el('span', { textContent: of.date }),
        el('span', { textContent: `epoch ${of.epoch}` })))));
      if (answer.next_before) {
        rows.append(el('li', { className: 'more' }, el('button', { type: 'button', textContent: 'Earlier uploads', onclick: () => next(answer.next_before).catch(failed) })));
      }
    };
    await next();
    return rows;
  }

  const open = (contributor) => {
    opened = contributor;
    show().catch(failed);
  };
  form.addEventListener('input', () => load().catch(failed));
  form.addEventListener('submit', (event) => event.preventDefault());
  more.addEventListener('click', () => load(known.length).catch(failed));
  return {
    load,
    /** Shows one, with its uploads. */
    async open(contributor) {
      form.reset();
      form.elements.hash.value = contributor;
      opened = contributor;
      await load();
    },
  };
}
