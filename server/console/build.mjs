// Bundles the console into dist/: index.html and assets/ with hashed names, each text with a .gz twin.

import { copyFile, mkdir, readFile, readdir, rm, writeFile } from 'node:fs/promises';
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

// The map library's licence asks to be handed on.
const library = 'node_modules/maplibre-gl';
const { version } = JSON.parse(await readFile(`${library}/package.json`, 'utf8'));
const licence = `assets/maplibre-gl-${version}-licence.txt`;
await copyFile(`${library}/LICENSE.txt`, `${DIST}/${licence}`);

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
