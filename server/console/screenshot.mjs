// A picture of the running console, taken with a plain Chromium:
//
//   node screenshot.mjs http://127.0.0.1:8080/ console.png [--size=1600x1000] [--scheme=dark] [--wait=6000] [--script='...']
//
// `--wait` is the time for tiles and events to come, in milliseconds; `--script` runs in the page before it,
// for instance `document.querySelector("[value=age]").click()`. CHROMIUM names the binary, `chromium` by default.

import { spawn } from 'node:child_process';
import { mkdtemp, rm, writeFile } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { setTimeout as sleep } from 'node:timers/promises';
import { parseArgs } from 'node:util';

const { values, positionals: [url, out] } = parseArgs({
  allowPositionals: true,
  options: {
    size: { type: 'string', default: '1600x1000' },
    scheme: { type: 'string', default: 'light' },
    wait: { type: 'string', default: '6000' },
    script: { type: 'string' },
  },
});
if (!url || !out) throw new Error('usage: node screenshot.mjs URL OUT.png [--size=WxH] [--wait=MS] [--script=JS]');
const [width, height] = values.size.split('x').map(Number);

const profile = await mkdtemp(join(tmpdir(), 'console-'));
const flags = [
  '--headless', '--no-sandbox', '--no-first-run', '--disable-quic', '--disable-sync', '--disable-background-networking',
  '--disable-component-update', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--hide-scrollbars',
  `--user-data-dir=${profile}`, `--window-size=${width},${height}`, '--remote-debugging-pipe', 'about:blank',
];
const browser = spawn(process.env.CHROMIUM ?? 'chromium', flags, { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] });
const [, , , orders, answers] = browser.stdio;

// The DevTools protocol over pipes: JSON messages, each ended by a zero byte.
const waiting = new Map();
let text = '';
let last = 0;
answers.setEncoding('utf8').on('data', (chunk) => {
  const messages = (text + chunk).split('\0');
  text = messages.pop();
  for (const { id, result, error, method, params } of messages.map((message) => JSON.parse(message))) {
    if (id) waiting.get(id)(error ? { error } : { result });
    else if (method === 'Runtime.exceptionThrown') console.error(params.exceptionDetails.exception?.description ?? params.exceptionDetails.text);
    else if (method === 'Log.entryAdded') console.error(`${params.entry.level}: ${params.entry.text} ${params.entry.url ?? ''}`);
  }
});
async function order(method, params = {}, sessionId = undefined) {
  last += 1;
  const id = last;
  const answer = new Promise((done) => waiting.set(id, done));
  orders.write(`${JSON.stringify({ id, method, params, sessionId })}\0`);
  const { result, error } = await answer;
  if (error) throw new Error(`${method}: ${error.message}`);
  return result;
}

try {
  const { targetInfos } = await order('Target.getTargets');
  const { targetId } = targetInfos.find(({ type }) => type === 'page');
  const { sessionId } = await order('Target.attachToTarget', { targetId, flatten: true });
  const page = (method, params) => order(method, params, sessionId);
  await page('Runtime.enable');
  await page('Log.enable');
  await page('Emulation.setDeviceMetricsOverride', { width, height, deviceScaleFactor: 1, mobile: false });
  await page('Emulation.setEmulatedMedia', { features: [{ name: 'prefers-color-scheme', value: values.scheme }] });
  await page('Page.navigate', { url });
  await sleep(Number(values.wait) / 2);
  if (values.script) await page('Runtime.evaluate', { expression: values.script, awaitPromise: true });
  await sleep(Number(values.wait) / 2);
  const { data } = await page('Page.captureScreenshot', { format: 'png' });
  await writeFile(out, Buffer.from(data, 'base64'));
} finally {
  browser.kill();
  await new Promise((ended) => (browser.exitCode === null ? browser.once('exit', ended) : ended()));
  await rm(profile, { recursive: true, force: true, maxRetries: 5 });
}
