//! Writes generated sections into the pages of `docs/benchmarks`. Only the text between a section's two markers is replaced.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

/// The page with `body` between `<!-- NAME:begin -->` and `<!-- NAME:end -->`. Where the page has no such markers, they are
/// added at its end.
///
/// # Errors
/// When the page has only one of the markers, or has them in the wrong order.
pub fn replaced(page: &str, name: &str, body: &str) -> anyhow::Result<String> {
    let (begin, end) = (format!("<!-- {name}:begin -->"), format!("<!-- {name}:end -->"));
    let body = body.trim_matches('\n');
    match (page.split_once(&begin), page.split_once(&end)) {
        (None, None) => {
            let page = page.trim_end_matches('\n');
            let gap = if page.is_empty() { "" } else { "\n\n" };
            Ok(format!("{page}{gap}{begin}\n{body}\n{end}\n"))
        }
        (Some((before, _)), Some((to_end, after))) if before.len() < to_end.len() => {
            Ok(format!("{before}{begin}\n{body}\n{end}{after}"))
        }
        _ => bail!("the markers `{begin}` and `{end}` must both be there, in this order"),
    }
}

/// The folder of the benchmarks' pages in the repository at this path. It is created if it does not exist.
///
/// # Errors
/// When the folder cannot be created.
pub fn pages(repository: &Path) -> anyhow::Result<PathBuf> {
    let pages = repository.join("docs/benchmarks");
    std::fs::create_dir_all(&pages).with_context(|| format!("making {}", pages.display()))?;
    Ok(pages)
}

/// Replaces a section of a page. The file is created if it does not exist.
///
/// # Errors
/// When the file cannot be read or written, or its markers are not a pair.
pub fn write_section(path: &Path, name: &str, body: &str) -> anyhow::Result<()> {
    let page = if path.exists() {
        std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?
    } else {
        String::new()
    };
    let page = replaced(&page, name, body).with_context(|| format!("in {}", path.display()))?;
    std::fs::write(path, page).with_context(|| format!("writing {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_lies_between_the_markers_changes() {
        let page = "# Page\n\n<!-- a:begin -->\nold\n<!-- a:end -->\n\ntail\n";
        let new = replaced(page, "a", "\nnew\nlines\n\n").unwrap();
        assert_eq!(new, "# Page\n\n<!-- a:begin -->\nnew\nlines\n<!-- a:end -->\n\ntail\n");
        assert_eq!(replaced(&new, "a", "new\nlines").unwrap(), new);
    }

    #[test]
    fn a_page_without_markers_gets_them_at_its_end() {
        assert_eq!(replaced("", "a", "x").unwrap(), "<!-- a:begin -->\nx\n<!-- a:end -->\n");
        assert_eq!(replaced("top\n", "a", "x").unwrap(), "top\n\n<!-- a:begin -->\nx\n<!-- a:end -->\n");
    }

    #[test]
    fn half_a_pair_of_markers_is_an_error() {
        for page in ["<!-- a:begin -->\n", "<!-- a:end -->", "<!-- a:end --> <!-- a:begin -->"] {
            assert!(replaced(page, "a", "x").is_err(), "{page}");
        }
    }

    #[test]
    fn a_file_is_made_when_it_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page.md");
        write_section(&path, "a", "one").unwrap();
        write_section(&path, "a", "two").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "<!-- a:begin -->\ntwo\n<!-- a:end -->\n");
    }
}
