// Drives the console of a running service as an operator would, in a Chromium that is installed already:
//
//   node drive.mjs http://127.0.0.1:8080 OUT
//
// Writes pictures to the folder OUT. The service must have a map, a PMTiles base map, some fixes, some uploads in quarantine and an
// alarm; whom nothing identifies it must take for a viewer, and others by the tokens in TOKENS: JSON with those of viewer,
// operator and admin. When all else is done it prints `end the service` and waits for a line, by which the service must be gone;
// then that it be started again, and waits for its new address. CHROMIUM names the binary.

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { once } from 'node:events';
import { mkdtemp, readFile, rm } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { createInterface } from 'node:readline';
import { setTimeout as sleep } from 'node:timers/promises';
import { launch } from 'puppeteer-core';

let [url] = process.argv.slice(2);
const [, out] = process.argv.slice(2);
const tokens = JSON.parse(process.env.TOKENS);
const axe = await readFile(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8');
const profile = await mkdtemp(join(tmpdir(), 'console-'));
const browser = await launch({
  executablePath: process.env.CHROMIUM ?? execFileSync('sh', ['-c', 'command -v chromium'], { encoding: 'utf8' }).trim(),
  userDataDir: profile,
  pipe: true,
  protocolTimeout: 240_000,
  args: [
    '--no-sandbox', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update',
    '--disable-sync', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--force-prefers-reduced-motion',
  ],
});
const page = await browser.newPage();
page.setDefaultTimeout(120_000);
const failures = [];
page.on('pageerror', (error) => failures.push(`the page throws: ${error.message}`));
page.on('console', (message) => {
  if (message.type() === 'error' && !/Failed to load resource/.test(message.text())) console.log(`console: ${message.text()}`);
  if (/content security policy/i.test(message.text())) failures.push(message.text());
});
page.on('response', (response) => response.status() >= 400 && console.log(`${response.status()}: ${response.url()}`));
const asked = [];
page.on('request', (request) => asked.push(request.url()));

const SIZES = { wide: { width: 1440, height: 900 }, narrow: { width: 390, height: 844 } };

async function look(size, scheme) {
  await page.setViewport(SIZES[size]);
  await page.emulateMediaFeatures([{ name: 'prefers-color-scheme', value: scheme }, { name: 'prefers-reduced-motion', value: 'reduce' }]);
}

async function opened(hash = '') {
  await page.goto('about:blank');
  await page.goto(`${url}/${hash}`, { waitUntil: 'domcontentloaded' });
  await page.waitForFunction(() => document.body.dataset.ready === 'true');
  await page.waitForFunction(() => document.getElementById('ready').textContent === 'ready' && document.getElementById('stream').textContent === 'live');
}

const text = (selector) => page.$eval(selector, (element) => (element.matches('input, output, select') ? element.value : element.textContent));
const holds = (selector, words) =>
  page.waitForFunction((s, w) => new RegExp(w, 'i').test(document.querySelector(s)?.textContent ?? ''), {}, selector, words);
const hash = () => page.evaluate(() => location.hash);

/** No rule of axe is broken as the page stands. */
async function accessible(where) {
  await page.evaluate(axe);
  const violations = await page.evaluate(async () => (await axe.run(document, { resultTypes: ['violations'] })).violations
    .map(({ id, nodes }) => `${id}: ${nodes.slice(0, 3).map(({ target, failureSummary }) => `${target} ${failureSummary}`).join(' | ')}`));
  assert.deepEqual(violations, [], `axe, ${where}`);
}

async function picture(name) {
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  await page.screenshot({ path: join(out, `${name}.png`) });
}

/** What the service answers to an operator who asks without the page. */
async function api(path) {
  const ask = () => fetch(`${url}/${path}`, { headers: { authorization: `Bearer ${tokens.operator}` } });
  let answer = await ask();
  // The machine may be busy: the service says then when to ask again.
  for (let i = 0; answer.status === 503 && i < 30; i += 1) {
    await sleep(1000);
    answer = await ask();
  }
  assert.equal(answer.status, 200, path);
  return answer.json();
}

async function signIn(token) {
  await page.waitForSelector('#signin[open]');
  await page.type('#signin-token', token);
  await page.click('#signin-yes');
}

async function become(role) {
  const known = await text('#signout');
  if (known.startsWith('Sign out')) {
    await Promise.all([page.waitForNavigation(), page.click('#signout')]);
    await page.waitForFunction(() => document.getElementById('signout').textContent === 'Sign in' && document.body.dataset.ready === 'true');
  }
  await page.click('#signout');
  await signIn(tokens[role]);
  await holds('#signout', `Sign out ${role}-1`);
}

/** All that can be clicked is reached by Tab, from the top of the page on. */
async function reachable(where) {
  await page.evaluate(() => {
    document.activeElement?.blur();
    window.scrollTo(0, 0);
    const can = 'button, a[href], input, select, canvas[tabindex], summary';
    const all = [...document.querySelectorAll(can)].filter((one) => one.checkVisibility({ visibilityProperty: true }) && !one.disabled && one.tabIndex >= 0);
    // Of some radio buttons, arrows lead from one to the next.
    window.missed = new Set(all.filter((one) => one.type !== 'radio' || one.checked));
    document.addEventListener('focusin', ({ target }) => window.missed.delete(target));
  });
  for (let i = 0; i < 400 && (await page.evaluate(() => window.missed.size)); i += 1) await page.keyboard.press('Tab');
  const missed = await page.evaluate(() => [...window.missed].filter((one) => one.isConnected).map((one) => one.outerHTML.slice(0, 120)));
  assert.deepEqual(missed, [], `not reached by the keyboard, ${where}`);
}

async function find(words) {
  await page.$eval('#sought', (input, value) => (input.value = value), words);
  await page.focus('#sought');
  await page.keyboard.press('Enter');
}

/** What is told of a place goes by Escape. */
async function closed() {
  await page.keyboard.press('Escape');
  await page.waitForFunction(() => !document.querySelector('.details'));
}

const shown = (selector) => page.$$eval(selector, (all) => all.filter((one) => one.checkVisibility()).length);

/** A cell that is served, and one that waits for more contributors. */
async function cells() {
  const { bounds } = await api('api/v1/map');
  const { tiles } = await api(`api/v1/map/diff?from=0&to=${(await api('api/v1/map')).epoch}`);
  assert.ok(bounds);
  for (const { id } of tiles) {
    const { cells: all } = await api(`api/v1/tiles/${id}/cells?limit=20000`);
    const of = (standing) => all.find((cell) => cell.standing === standing);
    const [served, waits] = [of('SERVED'), of('TOO_FEW_CONTRIBUTORS')];
    if (served && waits) return { id, served, waits };
  }
  throw new Error('no tile has both');
}

const at = ({ latitude_deg, longitude_deg }) => `${latitude_deg}, ${longitude_deg}`;

async function part(name) {
  await page.click(`#t-${name}`);
  await page.waitForSelector(`#p-${name}:not([hidden])`);
}

const lines = createInterface({ input: process.stdin });

/** Says what must be done outside, and waits for the answer. */
async function told(what) {
  const answer = once(lines, 'line');
  console.log(what);
  return (await answer)[0];
}

async function until(holds) {
  for (const end = Date.now() + 60_000; !holds(); await sleep(100)) assert.ok(Date.now() < end, `not in time: ${holds}`);
}

async function step(name, work) {
  await work();
  console.log(`ok: ${name}`);
}

async function steps() {
  let cell;
  await look('wide', 'dark');
  await step('the page opens, with what the service counts', async () => {
    await opened();
    await holds('#totals', 'epoch');
    assert.match(await hash(), /layer=evidence/);
  });
  await step('viewers look: nothing to decide, no contributors, only what is served', async () => {
    cell = await cells();
    assert.equal(await text('#signout'), 'Sign in');
    assert.equal(await shown('#t-contributors, .compare'), 0);
    for (const name of ['quarantine', 'history']) {
      await part(name);
      await page.waitForFunction((list) => document.querySelectorAll(`#${list} .entry`).length > 0, {}, name);
      assert.equal(await shown('.deciding'), 0, `${name} offers decisions`);
      await accessible(`${name}, as a viewer`);
      await picture(`viewer-${name}`);
    }
    await part('now');
    await holds('#fixes', '^$');
    await find(at(cell.served));
    await holds('.details .cell', 'Served: seen by 2 contributors');
    assert.equal(await shown('.details .hashes'), 0);
    await closed();
    await find(at(cell.waits));
    await page.waitForSelector('.details');
    assert.doesNotMatch(await text('.details'), /Not served/);
    await reachable('as a viewer');
  });
  await step('signing in: a wrong token is told, a right one is taken', async () => {
    await page.click('#signout');
    await page.waitForSelector('#signin[open]');
    await accessible('signing in');
    await picture('signin-wide-dark');
    await signIn('echofix_nonsense');
    await page.waitForFunction(() => !/asks who is there/.test(document.getElementById('signin-note').textContent));
    await signIn(tokens.operator);
    await holds('#signout', 'Sign out operator-1');
    await opened();
    await page.waitForFunction(() => document.querySelectorAll('#fixes button').length > 0);
    assert.equal(await shown('#t-contributors'), 1);
  });
  await step('parts of the panel, by the keyboard alone', async () => {
    await page.focus('#t-now');
    await page.keyboard.press('ArrowRight');
    await page.waitForSelector('#p-quarantine:not([hidden])');
    await page.keyboard.press('End');
    await page.waitForSelector('#p-history:not([hidden])');
    await page.keyboard.press('Home');
    await page.waitForSelector('#p-now:not([hidden])');
  });
  await step('quarantine: reason, offset, ids, alarm, place', async () => {
    await part('quarantine');
    await holds('#quarantine', 'Alarm: \\d+ contributors agree');
    await holds('#quarantine', 'shifted by 1\\.\\d+ m');
    const ids = await page.$$eval('#quarantine .ids dd', (all) => all.map((one) => one.textContent));
    assert.ok(ids.some((id) => /^[0-9a-f]{16}$/.test(id)) && ids.some((id) => /^[0-9a-f-]{36}$/.test(id)), ids.join());
    assert.ok(Number(await text('#quarantine-count')) > 0);
    const before = await hash();
    await page.click('#quarantine .entry:not(.alarm) .go');
    await page.waitForFunction((was) => location.hash !== was, {}, before);
  });
  for (const size of ['wide', 'narrow']) {
    for (const scheme of ['dark', 'light']) {
      await step(`every part, ${size} and ${scheme}: nothing beside the page, no rule of axe broken`, async () => {
        await look(size, scheme);
        for (const name of ['now', 'quarantine', 'contributors', 'history']) {
          await part(name);
          // Colours depend on the scheme, and what is there on the size: two of the four pairs show both.
          if ((size === 'wide') === (scheme === 'dark')) await accessible(`${name}, ${size}, ${scheme}`);
          const over = await page.evaluate(() => Math.max(document.documentElement.scrollWidth - innerWidth, document.getElementById('body').scrollWidth - document.getElementById('body').clientWidth));
          assert.ok(over <= 0, `${name}: ${over} pixels beside the page`);
          await picture(`${name}-${size}-${scheme}`);
        }
      });
    }
  }
  await look('wide', 'dark');
  await step('everything is reached by the keyboard, in every part', async () => {
    for (const name of ['now', 'quarantine', 'contributors', 'history']) {
      await part(name);
      await reachable(name);
    }
  });
  await step('contributors: sorted, filtered, with their uploads', async () => {
    await part('contributors');
    const hashes = () => page.$$eval('#contributors .hash', (all) => all.map((one) => one.textContent));
    await page.waitForFunction(() => document.querySelectorAll('#contributors .hash').length === 5);
    await page.select('#contributors-form [name=only]', 'quarantined');
    await page.waitForFunction(() => document.querySelectorAll('#contributors .hash').length === 3);
    await holds('#contributors-note', '^3 of 3$');
    const [kept] = await hashes();
    await page.focus('#contributors .go');
    await page.keyboard.press('Enter');
    await page.waitForSelector('#contributors .rows button');
    assert.equal(await page.$eval('#contributors .go', (one) => one.ariaExpanded), 'true');
    await holds('#contributors .rows', 'quarantined.*epoch \\d+');
    await accessible('contributors');
    await picture('contributors-wide-dark');
    await page.click('#contributors .rows button');
    await page.waitForSelector('#p-quarantine:not([hidden])');
    await find(kept);
    await page.waitForSelector('#p-contributors:not([hidden])');
    await page.waitForFunction((hash) => [...document.querySelectorAll('#contributors .hash')].map((one) => one.textContent).join() === hash, {}, kept);
    await page.$eval('#contributors-form', (form) => form.reset());
    await page.select('#contributors-form [name=sort]', 'uploads');
    await page.waitForFunction(() => document.querySelectorAll('#contributors .hash').length === 5);
    const listed = (await api('api/v1/contributors?sort=uploads')).contributors.map(({ contributor }) => contributor);
    await page.waitForFunction((all) => [...document.querySelectorAll('#contributors .hash')].map((one) => one.textContent).join() === all, {}, listed.join());
  });
  await step('the base map: vector tiles of a file, shown and hidden', async () => {
    const asksForTiles = () => asked.filter((address) => address.endsWith('/base-map.pmtiles')).length;
    assert.ok(asksForTiles() > 2, 'header, directory and tiles are read in ranges');
    assert.ok(asked.every((address) => !address.startsWith('http') || address.startsWith(url)), 'nothing from elsewhere');
    assert.equal(await page.$eval('#base', (box) => box.checked && box.checkVisibility()), true);
    await holds('.maplibregl-ctrl-attrib', 'Nobody');
    assert.equal(await page.$$eval('.maplibregl-ctrl-attrib b', (all) => all.length), 0, 'words, not markup');
    await picture('base-map-wide-dark');
    await page.click('#base');
    await picture('no-base-map-wide-dark');
    await page.click('#base');
  });
  await step('a revocation is told, can be left, is taken with a reason, and undone', async () => {
    await part('quarantine');
    const listed = Number(await text('#quarantine-count'));
    const click = () => page.click('#quarantine .entry:not(.alarm) [aria-label^="Revoke contributor"]');
    await click();
    await page.waitForSelector('#decide-yes:not([disabled])');
    await holds('#decide-numbers', 'uploads taken back');
    await accessible('the question');
    await picture('decide-wide-dark');
    await page.keyboard.press('Escape');
    await page.waitForFunction(() => !document.getElementById('decide').open);
    assert.equal(Number(await text('#quarantine-count')), listed, 'left as it is');
    await click();
    await page.waitForSelector('#decide-yes:not([disabled])');
    await page.type('#decide-reason', 'its antenna is bent');
    await page.click('#decide-yes');
    await page.waitForFunction((was) => Number(document.getElementById('quarantine-count').textContent) < was, {}, listed);
    await part('contributors');
    await page.select('#contributors-form [name=only]', 'revoked');
    await holds('#contributors', 'revoked by operator-1 .*“its antenna is bent”');
    await page.waitForSelector('#contributors [aria-label^="Undo revocation"]');
    await page.select('#contributors-form [name=only]', 'all');
    await page.waitForFunction(() => document.querySelectorAll('#contributors .hash').length === 5);
    await part('history');
    await holds('#history', 'contributor [0-9a-f]{16} revoked[^]*its antenna is bent');
    await page.click('#history [aria-label^="Undo decision"]');
    await page.waitForSelector('#decide-yes:not([disabled])');
    await page.type('#decide-reason', 'it was not');
    await page.click('#decide-yes');
    await holds('#history', 'undone by \\d+');
    await page.waitForFunction((was) => Number(document.getElementById('quarantine-count').textContent) === was, {}, listed);
    await picture('undone-wide-dark');
  });
  await step('the past: pictures of an epoch, and what differs', async () => {
    asked.length = 0;
    await page.focus('#epoch');
    await page.keyboard.press('Home');
    await page.keyboard.press('ArrowRight');
    await holds('#epoch-shown', 'epoch \\d+ of');
    await page.waitForFunction(() => !document.getElementById('compare').disabled);
    await page.click('#compare');
    await page.waitForSelector('#difference-note:not([hidden])');
    assert.ok(asked.some((address) => /\.png\?epoch=\d+$/.test(address)), 'pictures of that epoch');
    await picture('difference-wide-dark');
    await page.click('#epoch-now');
    await holds('#epoch-shown', 'now');
  });
  await step('the search: a position, a tile, an upload, nonsense; and all of the map', async () => {
    const { uploads } = await api('api/v1/uploads?limit=50');
    await find(uploads[0].upload_id);
    await holds('#found', 'In quarantine');
    const counted = uploads.find(({ outcome }) => outcome === 'COUNTED');
    await find(counted.upload_id);
    await holds('#found', `Upload ${counted.upload_id} of contributor [0-9a-f]{16}: counted, .*epoch ${counted.epoch}`);
    await page.click('#found-act');
    await holds('#difference-note', 'cells added');
    await find('no such thing');
    await holds('#found', 'Nothing of this name');
    const map = await api('api/v1/map');
    await find(`${map.center[1]}, ${map.center[0]}`);
    await page.waitForFunction((lat) => Math.abs(Number(/view=[^/]+\/([-\d.]+)/.exec(location.hash)?.[1]) - lat) < 1e-3, {}, map.center[1]);
    for (const fix of ['fix', 'fix 2']) {
      await find(fix);
      await holds('.details', 'correction');
    }
    await find('fix 99');
    await holds('#found', 'No such fix');
    await find(cell.id);
    await holds('.details', `Tile ${cell.id}`);
  });
  await step('a cell: hits, passes, contributors, days, presence, and why it is served or not', async () => {
    for (const [name, of, words] of [['served', cell.served, 'Served: seen by 2 contributors, 2 are needed'], ['waits', cell.waits, 'Not served: seen by 1 contributor, 2 are needed']]) {
      await find(at(of));
      await holds('.details .cell', `${words}[^]*hits${of.hits}passes${of.passes} of ${of.observed} in view`);
      await holds('.details .cell', `presence${Math.round(of.presence * 100)} %seen${of.first_date}`);
      assert.match(await text('.details .hashes'), /[0-9a-f]{16}/);
      await accessible(`a cell, ${name}`);
      await picture(`cell-${name}-wide-dark`);
    }
    await closed();
    await page.focus('canvas.maplibregl-canvas');
    await page.keyboard.press('Enter');
    await holds('.details', 'Tile');
    await closed();
    await page.waitForFunction(() => document.activeElement.matches('canvas'));
    // By the mouse, in the middle of the map: where the search has led.
    await page.mouse.click(SIZES.wide.width / 2, SIZES.wide.height / 2);
    await holds('.details .cell', 'Cell \\d+, \\d+');
  });
  await step('all of the map', async () => {
    const before = await hash();
    await page.click('#fit');
    await page.waitForFunction((was) => location.hash !== was, {}, before);
  });
  await step('layers and filters', async () => {
    for (const layer of ['coverage', 'age', 'localizability', 'evidence']) {
      await page.click(`input[value=${layer}]`);
      await page.waitForFunction((name) => location.hash.includes(`layer=${name}`), {}, layer);
    }
    await part('now');
    await page.select('#filter', 'QUARANTINED');
    await page.waitForFunction(() => [...document.querySelectorAll('#uploads b')].every((b) => b.textContent === 'quarantined'));
    await page.click('#uploads button');
    await page.waitForSelector('#p-quarantine:not([hidden])');
  });
  await step('rows are clicked: a fix, an upload', async () => {
    await part('now');
    await page.click('#fixes button');
    await holds('.details', 'correction');
    await page.select('#filter', '');
    await page.waitForFunction(() => [...document.querySelectorAll('#uploads b')].some((b) => b.textContent === 'counted') || document.querySelectorAll('#uploads button').length > 3);
    await page.click('#uploads button');
    await holds('#found', 'epoch \\d+');
  });
  await step('each role: what it may see and decide', async () => {
    for (const [role, decides] of [['viewer', false], ['admin', true]]) {
      await become(role);
      await opened();
      await part('quarantine');
      await page.waitForFunction(() => document.querySelectorAll('#quarantine .entry').length > 0);
      assert.equal((await shown('#p-quarantine .deciding')) > 0, decides, role);
      assert.equal(await shown('#t-contributors'), Number(decides), role);
      await picture(`${role}-wide-dark`);
    }
    await part('contributors');
    await page.waitForSelector('#contributors [aria-label^="Revoke contributor"]');
  });
  await step('links that name no view or layer show the map', async () => {
    for (const bad of ['#view=a/b/c&layer=evidence', '#view=99/991/2&layer=roads', '#view=&layer=', '#%%%']) {
      await opened(bad);
      await page.waitForFunction(() => /layer=evidence/.test(location.hash) && /view=1\d/.test(location.hash));
    }
  });
  await step('a service that is gone is told within 5 s', async () => {
    await told('end the service');
    const gone = Date.now();
    await page.waitForFunction(() => document.getElementById('ready').textContent !== 'ready' && document.getElementById('stream').textContent !== 'live');
    // The machine may be busy; the page itself waits 4.5 s.
    console.log(`told after ${((Date.now() - gone) / 1000).toFixed(1)} s`);
    await holds('#alert', 'does not answer');
    await picture('gone-wide-dark');
  });
  await step('who is nobody is asked to sign in; the base map of another service, and nothing else from there', async () => {
    url = await told('start it again, for nobody, over tiles of another');
    asked.length = 0;
    await page.goto(`${url}/`, { waitUntil: 'domcontentloaded' });
    await page.waitForSelector('#signin[open]');
    await signIn(tokens.viewer);
    await page.waitForFunction(() => document.getElementById('ready').textContent === 'ready');
    const { url: template } = await api('base-map');
    const origin = new URL(template).origin;
    await page.waitForFunction(() => document.querySelector('.maplibregl-ctrl-attrib a[href="https://licence.example/map"]'));
    await until(() => asked.some((address) => address.startsWith(`${origin}/`)));
    assert.deepEqual(asked.filter((address) => address.startsWith('http') && ![url, origin].includes(new URL(address).origin)), []);
    assert.ok(asked.filter((address) => address.startsWith(origin)).every((address) => /\/\d+\/\d+\/\d+\.png$/.test(address)));
    await picture('tiles-wide-dark');
  });
  assert.deepEqual(failures, []);
}

try {
  await steps();
} catch (error) {
  await page.screenshot({ path: join(out, 'failed.png') }).catch(() => {});
  console.error(error);
  process.exitCode = 1;
} finally {
  lines.close();
  await browser.close().catch(() => {});
  await rm(profile, { recursive: true, force: true }).catch(() => {});
}
