//! Builds the console and embeds it: `console_assets.rs` lists its files for `src/http/console.rs`.
//!
//! Nothing is written into the source tree: the console is copied to `OUT_DIR` and bundled there.
//! `ECHOFIX_CONSOLE_DIST=DIR` embeds a folder that was built before (`npm ci && npm run build`).

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

/// What the bundle depends on, under `console/`.
const SOURCES: [&str; 5] = ["package.json", "package-lock.json", "build.mjs", "index.html", "src"];

type Outcome<T> = Result<T, String>;

fn main() {
    if let Err(reason) = run() {
        eprintln!("\nThe operators' console could not be built.\n{reason}\n");
        std::process::exit(1);
    }
}

fn run() -> Outcome<()> {
    println!("cargo::rerun-if-env-changed=ECHOFIX_CONSOLE_DIST");
    println!("cargo::rerun-if-changed=build.rs");
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or("cargo sets no OUT_DIR")?);
    let dist = match env::var_os("ECHOFIX_CONSOLE_DIST") {
        Some(ready) => ready_built(Path::new(&ready))?,
        None => bundled(&out.join("console"))?,
    };
    let table = table(&dist)?;
    fs::write(out.join("console_assets.rs"), table).map_err(|e| format!("{}: {e}", out.display()))
}

/// A folder that was built before.
fn ready_built(dist: &Path) -> Outcome<PathBuf> {
    let dist = dist.canonicalize().map_err(|e| format!("ECHOFIX_CONSOLE_DIST={}: {e}", dist.display()))?;
    for path in files_below(&dist)? {
        println!("cargo::rerun-if-changed={}", path.display());
    }
    if !dist.join("index.html").is_file() {
        return Err(format!("ECHOFIX_CONSOLE_DIST={} holds no index.html", dist.display()));
    }
    Ok(dist)
}

/// Bundles a copy of the sources.
fn bundled(work: &Path) -> Outcome<PathBuf> {
    let console = Path::new("console");
    let lock_before = fs::read(work.join("package-lock.json")).ok();
    remove(&work.join("src"))?;
    for source in SOURCES {
        let from = console.join(source);
        println!("cargo::rerun-if-changed={}", from.display());
        for file in files_below(&from)? {
            println!("cargo::rerun-if-changed={}", file.display());
            let relative = file.strip_prefix(console).map_err(|e| e.to_string())?;
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

fn npm(work: &Path, arguments: &[&str]) -> Outcome<()> {
    let advice = "It needs Node.js 20 or newer with npm (Debian: `apt-get install nodejs npm`) and, the first \
                  time, the npm registry. Or build `server/console` elsewhere and point ECHOFIX_CONSOLE_DIST \
                  at its `dist` folder.";
    let program = if cfg!(windows) { "npm.cmd" } else { "npm" };
    let output = Command::new(program).args(arguments).current_dir(work).output();
    let output = output.map_err(|e| format!("{program} could not be run: {e}.\n{advice}"))?;
    if output.status.success() {
        return Ok(());
    }
    let said =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).join("\n");
    Err(format!("`npm {}` failed ({}):\n{}\n\n{advice}", arguments.join(" "), output.status, said.trim()))
}

/// Rust source that embeds every file of the bundle, with its `.gz` twin where there is one.
fn table(dist: &Path) -> Outcome<String> {
    let mut files = files_below(dist)?;
    files.retain(|path| path.extension().is_none_or(|ending| ending != "gz"));
    files.sort();
    let mut table = format!("static ASSETS: [Asset; {}] = [\n", files.len());
    for path in files {
        let name = text(path.strip_prefix(dist).map_err(|e| e.to_string())?)?.replace('\\', "/");
        let path = text(&path)?;
        let twin = format!("{path}.gz");
        let is_packed = Path::new(&twin).is_file();
        let gzip = if is_packed { format!("Some(include_bytes!({twin:?}))") } else { "None".to_owned() };
        let line = format!("    Asset {{ name: {name:?}, plain: include_bytes!({path:?}), gzip: {gzip} }},");
        writeln!(table, "{line}").map_err(|e| e.to_string())?;
    }
    Ok(table + "];\n")
}

fn text(path: &Path) -> Outcome<&str> {
    path.to_str().ok_or_else(|| format!("{}: the path is not UTF-8", path.display()))
}

/// A file, or all files of a folder.
fn files_below(path: &Path) -> Outcome<Vec<PathBuf>> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let told = |e: io::Error| format!("{}: {e}", path.display());
    let mut files = Vec::new();
    for entry in fs::read_dir(path).map_err(told)? {
        files.extend(files_below(&entry.map_err(told)?.path())?);
    }
    Ok(files)
}

fn copy(from: &Path, to: &Path) -> Outcome<()> {
    let copied = to.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::copy(from, to));
    copied.map(drop).map_err(|e| format!("{} to {}: {e}", from.display(), to.display()))
}

fn remove(folder: &Path) -> Outcome<()> {
    match fs::remove_dir_all(folder) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(format!("{}: {e}", folder.display())),
        _ => Ok(()),
    }
}
