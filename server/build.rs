//! Builds the console and embeds it: `console_assets.rs` lists its files for `src/http/console.rs`.
//!
//! Without the feature `console` there is nothing to build, and no npm is needed.
//!
//! Nothing is written into the source tree: the console is copied to `OUT_DIR` and bundled there.
//! `ECHOFIX_CONSOLE_DIST=DIR` embeds a folder that was built before (`npm ci && npm run build`).

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fmt, fs, io};

/// What the bundle depends on, under `console/`.
const SOURCES: [&str; 6] =
    ["package.json", "package-lock.json", "build.mjs", "index.html", "pmtiles-licence.txt", "src"];

/// Why the console cannot be built. The words are all that there is to know: cargo prints them.
#[derive(Debug)]
struct BuildFailure(String);

impl fmt::Display for BuildFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

type BuildResult<T> = Result<T, BuildFailure>;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    if env::var_os("CARGO_FEATURE_CONSOLE").is_none() {
        return;
    }
    if let Err(reason) = run() {
        eprintln!("\nThe operators' console could not be built.\n{reason}\n");
        std::process::exit(1);
    }
}

fn run() -> BuildResult<()> {
    println!("cargo::rerun-if-env-changed=ECHOFIX_CONSOLE_DIST");
    let out = PathBuf::from(
        env::var_os("OUT_DIR").ok_or_else(|| BuildFailure("cargo sets no OUT_DIR".to_owned()))?,
    );
    let dist = match env::var_os("ECHOFIX_CONSOLE_DIST") {
        Some(ready) => ready_built(Path::new(&ready))?,
        None => bundled(&out.join("console"))?,
    };
    let table = table(&dist)?;
    fs::write(out.join("console_assets.rs"), table).map_err(|e| at(&out, e))
}

/// What went wrong with a path.
fn at(path: &Path, what: impl fmt::Display) -> BuildFailure {
    BuildFailure(format!("{}: {what}", path.display()))
}

/// A folder that was built before.
fn ready_built(dist: &Path) -> BuildResult<PathBuf> {
    let dist = dist
        .canonicalize()
        .map_err(|e| BuildFailure(format!("ECHOFIX_CONSOLE_DIST={}: {e}", dist.display())))?;
    for path in files_below(&dist)? {
        println!("cargo::rerun-if-changed={}", path.display());
    }
    if !dist.join("index.html").is_file() {
        return Err(BuildFailure(format!("ECHOFIX_CONSOLE_DIST={} holds no index.html", dist.display())));
    }
    Ok(dist)
}

/// Bundles a copy of the sources.
fn bundled(work: &Path) -> BuildResult<PathBuf> {
    let console = Path::new("console");
    let lock_before = fs::read(work.join("package-lock.json")).ok();
    remove(&work.join("src"))?;
    for source in SOURCES {
        let from = console.join(source);
        println!("cargo::rerun-if-changed={}", from.display());
        for file in files_below(&from)? {
            println!("cargo::rerun-if-changed={}", file.display());
            let relative = file.strip_prefix(console).map_err(|e| at(&file, e))?;
            copy(&file, &work.join(relative))?;
        }
    }
    let lock = fs::read(work.join("package-lock.json")).ok();
    let installed = work.join("node_modules/.package-lock.json").is_file();
    if lock != lock_before || !installed {
        // No package needs its install script: esbuild's binary is a package of its own.
        npm(work, &["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"])?;
    }
    remove(&work.join("dist"))?;
    npm(work, &["run", "--silent", "build"])?;
    Ok(work.join("dist"))
}

fn npm(work: &Path, arguments: &[&str]) -> BuildResult<()> {
    let advice = "It needs Node.js 20 or newer with npm (Debian: `apt-get install nodejs npm`) and, the first \
                  time, the npm registry. Or build `server/console` elsewhere and point ECHOFIX_CONSOLE_DIST \
                  at its `dist` folder.";
    let program = if cfg!(windows) { "npm.cmd" } else { "npm" };
    let output = Command::new(program).args(arguments).current_dir(work).output();
    let output = output.map_err(|e| BuildFailure(format!("{program} could not be run: {e}.\n{advice}")))?;
    if output.status.success() {
        return Ok(());
    }
    let printed =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).join("\n");
    let (command, status, printed) = (arguments.join(" "), output.status, printed.trim());
    Err(BuildFailure(format!("`npm {command}` failed ({status}):\n{printed}\n\n{advice}")))
}

/// Rust source that embeds every file of the bundle, with its `.gz` twin where there is one.
fn table(dist: &Path) -> BuildResult<String> {
    let mut files = files_below(dist)?;
    files.retain(|path| path.extension().is_none_or(|ending| ending != "gz"));
    files.sort();
    let mut table = format!("static ASSETS: [Asset; {}] = [\n", files.len());
    for path in files {
        let name = text(path.strip_prefix(dist).map_err(|e| at(&path, e))?)?.replace('\\', "/");
        let path = text(&path)?;
        let twin = format!("{path}.gz");
        let is_packed = Path::new(&twin).is_file();
        let gzip = if is_packed { format!("Some(include_bytes!({twin:?}))") } else { "None".to_owned() };
        let line = format!("    Asset {{ name: {name:?}, plain: include_bytes!({path:?}), gzip: {gzip} }},");
        table += &line;
        table += "\n";
    }
    Ok(table + "];\n")
}

fn text(path: &Path) -> BuildResult<&str> {
    path.to_str().ok_or_else(|| at(path, "the path is not UTF-8"))
}

/// A file, or all files of a folder.
fn files_below(path: &Path) -> BuildResult<Vec<PathBuf>> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let failed = |e: io::Error| at(path, e);
    let mut files = Vec::new();
    for entry in fs::read_dir(path).map_err(failed)? {
        files.extend(files_below(&entry.map_err(failed)?.path())?);
    }
    Ok(files)
}

fn copy(from: &Path, to: &Path) -> BuildResult<()> {
    let copied = to.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::copy(from, to));
    copied.map(drop).map_err(|e| at(from, format!("cannot be copied to {}: {e}", to.display())))
}

fn remove(folder: &Path) -> BuildResult<()> {
    match fs::remove_dir_all(folder) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(at(folder, e)),
        _ => Ok(()),
    }
}
