// The side panel: the service in numbers.

import { NONE, byId, el, fill, numbers } from './dom.js';
import { ago, count, figure, percent, quantile, size, words } from './format.js';
import { families, familyOf } from './verdicts.js';

const SHOWN_FIXES = 7;
const SHOWN_UPLOADS = 6;
/** Fixes that rates and shares are taken over. */
const RECENT = 200;

export function showTotals(map) {
  const { totals, waiting } = map;
  const [bytes, unit] = size(totals.bytes);
  numbers(byId('totals'), [
    ['epoch', count(map.epoch)],
    ['tiles', count(totals.tiles)],
    ['area', figure(totals.area_km2), 'km²'],
    ['cells', count(totals.cells)],
    ['stored', bytes, unit],
    ['newest', totals.newest_date ?? 'none'],
    ...(waiting.tiles ? [['waiting', count(waiting.tiles)]] : []),
  ]);
  byId('waits').hidden = waiting.tiles === 0;
  byId('waits').textContent = whyWaiting(waiting);
  // Tiles that wait are not served: they leave the map as empty as none.
  byId('empty').hidden = totals.tiles > waiting.tiles;
  byId('empty-none').hidden = waiting.tiles > 0;
  byId('empty-waits').hidden = waiting.tiles === 0;
  byId('empty-waits').textContent = whyWaiting(waiting);
}

/** Why tiles are not served yet, in words. */
function whyWaiting({ tiles, contributors, needed }) {
  const many = tiles === 1 ? '1 tile waits' : `${count(tiles)} tiles wait`;
  const seen = contributors === 1 ? '1 contributor has' : `${count(contributors)} contributors have`;
  const then =
    contributors < needed ?
      `${seen} seen the same there at most, and ${count(needed)} are needed (mapping.publish_contributors).`
    : 'What was seen there is not confirmed by enough contributors.';
  return `${many} for more contributors: ${then}`;
}

export function showProgress({ state, epoch, journaled }) {
  const note = byId('backlog');
  const waiting = journaled - epoch;
  note.hidden = waiting === 0 && state === 'serving';
  note.textContent =
    state === 'rebuilding' ? `Rebuilding: ${count(epoch)} of ${count(journaled)} uploads folded.`
    : state === 'stalled' ? `Folding fails and is tried again; ${count(waiting)} uploads wait.`
    : `${count(waiting)} ${waiting === 1 ? 'upload waits' : 'uploads wait'} to be folded.`;
}

export function showHealth({ ready, reason, uploading }) {
  const takes = uploading.ready;
  chip(byId('ready'), ready ? (takes ? 'ready' : 'no uploads') : 'not ready', ready && takes ? 'good' : 'bad');
  const alert = byId('alert');
  alert.hidden = !reason;
  alert.textContent = !reason ? '' : ready ? `Not all is well: ${reason}` : `Not ready: ${reason}`;
}

/** Nothing is heard of the service: what was said before may no longer hold. */
export function showStale() {
  chip(byId('ready'), 'unknown', 'wait');
  const alert = byId('alert');
  alert.hidden = false;
  alert.textContent = 'The service does not answer. What is shown is as it was last heard.';
}

export function showStream(state) {
  const [text, tone] = { live: ['live', 'good'], lost: ['reconnecting', 'bad'] }[state];
  chip(byId('stream'), text, tone);
}

function chip(element, text, tone) {
  element.dataset.tone = tone;
  if (element.textContent !== text) element.textContent = text;
}

/** What the last fixes amount to, newest first. */
export function showRates(fixes) {
  const recent = fixes.slice(0, RECENT);
  const minute_ago = (Date.now() - 60_000) * 1000;
  const rate = fixes.filter((fix) => fix.answered_us > minute_ago).length;
  const usable = recent.filter((fix) => fix.status === 'USABLE');
  const or = (list, text) => (list.length ? text() : NONE);
  numbers(byId('fixes-numbers'), [
    ['last minute', count(rate)],
    ['usable', or(recent, () => percent(usable.length / recent.length))],
    ['correction', or(usable, () => figure(quantile(usable.map((f) => f.correction_m)))), 'm'],
    ['matched', or(recent, () => percent(quantile(recent.map((f) => f.matched_fraction))))],
    ['align p50', or(recent, () => figure(quantile(recent.map((f) => f.align_ms)))), 'ms'],
    ['align p95', or(recent, () => figure(quantile(recent.map((f) => f.align_ms), 0.95))), 'ms'],
  ]);
  byId('fixes-note').textContent = recent.length ? `medians of the last ${recent.length}` : 'none yet';
  strip(byId('strip'), recent);
  key(recent);
}

/** `fixes` newest first; `choose` is called with a fix. */
export function showFixes(fixes, choose) {
  const row = (fix) => {
    const family = familyOf(fix.status);
    const dot = el('i', { className: 'dot' });
    dot.style.background = family.color;
    return el('li', {}, el(
      'button', { type: 'button', title: fix.reason, onclick: () => choose(fix) },
      dot, el('b', { textContent: words(fix.status) }),
      el('span', { textContent: `${figure(fix.correction_m)} m` }),
      el('span', { textContent: percent(fix.matched_fraction) }),
      el('span', { textContent: `${fix.align_ms.toFixed(0)} ms` }),
      since(fix.answered_us),
    ));
  };
  fill(byId('fixes'), fixes.slice(0, SHOWN_FIXES).map(row));
}

/** How long ago something was, which grows. */
const since = (us) => el('time', { textContent: ago(us), data: { us } });

/** Lets all of these grow, and leaves their rows as they are: somebody may be pressing one. */
export function showAges() {
  for (const time of document.querySelectorAll('time[data-us]')) time.textContent = ago(Number(time.dataset.us));
}

/** The verdicts as a strip of bars: the colour is the verdict, the height the matched fraction. */
function strip(canvas, fixes) {
  canvas.hidden = fixes.length === 0;
  const ratio = window.devicePixelRatio;
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = canvas.getContext('2d');
  pen.scale(ratio, ratio);
  const bar = 4;
  fixes.slice(0, Math.floor(width / bar)).forEach((fix, i) => {
    const tall = 4 + (height - 4) * fix.matched_fraction;
    pen.fillStyle = familyOf(fix.status).color;
    pen.fillRect(width - (i + 1) * bar, height - tall, bar - 1.5, tall);
  });
}

function key(fixes) {
  const entry = (family) => {
    const count = fixes.filter((fix) => familyOf(fix.status) === family).length;
    const dot = el('i', { className: 'dot' });
    dot.style.background = family.color;
    return count ? el('li', {}, dot, `${family.name} ${count}`) : null;
  };
  byId('verdicts').replaceChildren(...families.map(entry).filter(Boolean));
}

const isOf = (filter) => ({ outcome }) =>
  !filter || (filter === 'REFUSED' ? !['COUNTED', 'QUARANTINED', 'DUPLICATE'].includes(outcome) : outcome === filter);

/** `uploads` newest first, of which those of an outcome are shown; `choose` is called with one. */
export function showUploads(all, filter, choose) {
  const uploads = all.filter(isOf(filter));
  const tone = (outcome) => ({ COUNTED: 'good', DUPLICATE: 'wait' })[outcome] ?? 'bad';
  const row = (upload) =>
    el(
      'li', {},
      el('button', { type: 'button', title: upload.upload_id, onclick: () => choose(upload) },
        el('i', { className: 'dot', data: { tone: tone(upload.outcome) } }),
        el('b', { textContent: words(upload.outcome) }),
        el('span', { textContent: upload.kept ? whyKept(upload.kept) : upload.detections_counted ? `${count(upload.detections_counted)} det` : '' }),
        el('span', { textContent: upload.epoch ? `epoch ${upload.epoch}` : '' }),
        since(upload.answered_us),
      ),
    );
  const none = el('li', { className: 'none', textContent: filter ? 'None of these since the service started.' : 'None since the service started.' });
  fill(byId('uploads'), uploads.length ? uploads.slice(0, SHOWN_UPLOADS).map(row) : [none]);
}

const whyKept = ({ reason, offset_m }) =>
  offset_m == null ? words(reason) : `${words(reason)} by ${offset_m.toFixed(1)} m`;
