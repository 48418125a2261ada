// Bundles the console into dist/: index.html and assets/ with hashed names, each text with a .gz twin.

import { createHash } from 'node:crypto';
import { mkdir, readFile, readdir, rm, writeFile } from 'node:fs/promises';
import { basename } from 'node:path';
import { gzipSync } from 'node:zlib';
import { build } from 'esbuild';

const DIST = 'dist';

await rm(DIST, { recursive: true, force: true });
await mkdir(`${DIST}/assets`, { recursive: true });

const bundle = (options) =>
  build({
    bundle: true,
    minify: true,
    format: 'esm',
    target: 'es2022',
    outdir: `${DIST}/assets`,
    entryNames: '[name]-[hash]',
    assetNames: '[name]-[hash]',
    legalComments: 'eof',
    metafile: true,
    logLevel: 'warning',
    ...options,
  });

/** Name of the bundled file that an entry became. */
const outputOf = ({ metafile }, ending) =>
  basename(Object.keys(metafile.outputs).find((name) => name.endsWith(ending)));

// The map library's worker is a script of its own; the page gets its hashed name.
const worker = await bundle({ entryPoints: { worker: 'maplibre-gl/dist/maplibre-gl-worker.mjs' } });
const page = await bundle({
  entryPoints: { console: 'src/main.js' },
  define: { WORKER_URL: JSON.stringify(`assets/${outputOf(worker, '.js')}`) },
});

// The libraries' licences ask to be handed on. PMTiles has its own in its README only.
const BSD_3 = await readFile('pmtiles-licence.txt', 'utf8');
const libraries = [['maplibre-gl', 'LICENSE.txt'], ['pmtiles'], ['fflate', 'LICENSE']];
const written = libraries.map(async ([name, file]) => {
  const { version } = JSON.parse(await readFile(`node_modules/${name}/package.json`, 'utf8'));
  const text = file ? await readFile(`node_modules/${name}/${file}`, 'utf8') : BSD_3;
  return `${name} ${version}\n\n${text.trim()}\n`;
});
const licences = (await Promise.all(written)).join('\n\n');
const licence = `assets/licences-${createHash('sha256').update(licences).digest('hex').slice(0, 8)}.txt`;
await writeFile(`${DIST}/${licence}`, licences);

const html = (await readFile('index.html', 'utf8'))
  .replace('{{script}}', `assets/${outputOf(page, '.js')}`)
  .replace('{{licence}}', licence)
  .replace('{{style}}', `assets/${outputOf(page, '.css')}`);
await writeFile(`${DIST}/index.html`, html);

const texts = (await readdir(`${DIST}/assets`)).map((name) => `assets/${name}`);
for (const name of ['index.html', ...texts]) {
  const plain = await readFile(`${DIST}/${name}`);
  const packed = gzipSync(plain, { level: 9 });
  if (packed.length < plain.length) await writeFile(`${DIST}/${name}.gz`, packed);
}
