// Drives the console of a running service as an operator would, in a Chromium that is installed already:
//
//   node drive.mjs http://127.0.0.1:8080 OUT
//
// Writes pictures to the folder OUT. The service must have a map, some uploads in quarantine and an alarm. When all else
// is done it prints `end the service` and waits for a line, by which the service must be gone. CHROMIUM names the binary.

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtemp, readFile, rm } from 'node:fs/promises';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { createInterface } from 'node:readline/promises';
import { launch } from 'puppeteer-core';

const [url, out] = process.argv.slice(2);
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
page.on('console', (message) => message.type() === 'error' && console.log(`console: ${message.text()}`));
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

const text = (selector) => page.$eval(selector, (element) => element.value ?? element.textContent);
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

async function part(name) {
  await page.click(`#t-${name}`);
  await page.waitForSelector(`#p-${name}:not([hidden])`);
}

async function step(name, work) {
  await work();
  console.log(`ok: ${name}`);
}

async function steps() {
  await look('wide', 'dark');
  await step('the page opens, with what the service counts', async () => {
    await opened();
    await holds('#totals', 'epoch');
    assert.match(await hash(), /layer=evidence/);
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
        for (const name of ['now', 'quarantine', 'history']) {
          await part(name);
          // Colours depend on the scheme, and what is there on the size: two of the four pairs show both.
          if ((size === 'wide') === (scheme === 'dark')) await accessible(`${name}, ${size}, ${scheme}`);
          const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
          assert.ok(over <= 0, `${name}: ${over} pixels beside the page`);
          await picture(`${name}-${size}-${scheme}`);
        }
      });
    }
  }
  await look('wide', 'dark');
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
    const find = async (words) => {
      await page.$eval('#sought', (input, value) => (input.value = value), words);
      await page.focus('#sought');
      await page.keyboard.press('Enter');
    };
    const uploads = await (await fetch(`${url}/api/v1/uploads?limit=1`)).json();
    await find(uploads.uploads[0].upload_id);
    await page.waitForSelector('#found:not([hidden])');
    await find('no such thing');
    await holds('#found', 'Nothing of this name');
    const map = await (await fetch(`${url}/api/v1/map`)).json();
    await find(`${map.center[1]}, ${map.center[0]}`);
    await page.waitForFunction((lat) => Math.abs(Number(/view=[^/]+\/([-\d.]+)/.exec(location.hash)?.[1]) - lat) < 1e-3, {}, map.center[1]);
    const diff = await (await fetch(`${url}/api/v1/map/diff?from=0&to=2`)).json();
    await find(diff.tiles[0].id);
    await holds('.details', `Tile ${diff.tiles[0].id}`);
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
  await step('links that name no view or layer show the map', async () => {
    for (const bad of ['#view=a/b/c&layer=evidence', '#view=99/991/2&layer=roads', '#view=&layer=', '#%%%']) {
      await opened(bad);
      await page.waitForFunction(() => /layer=evidence/.test(location.hash) && /view=1\d/.test(location.hash));
    }
  });
  await step('a service that is gone is told within 5 s', async () => {
    const line = createInterface({ input: process.stdin });
    const ended = line.question('');
    console.log('end the service');
    await ended;
    line.close();
    const gone = Date.now();
    await page.waitForFunction(() => document.getElementById('ready').textContent !== 'ready' && document.getElementById('stream').textContent !== 'live');
    // The machine may be busy; the page itself waits 4.5 s.
    console.log(`told after ${((Date.now() - gone) / 1000).toFixed(1)} s`);
    await holds('#alert', 'does not answer');
    await picture('gone-wide-dark');
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
  await browser.close().catch(() => {});
  await rm(profile, { recursive: true, force: true }).catch(() => {});
}
