//! A part of a page that is written anew, between two marks.

use std::path::Path;

use anyhow::{Context, bail};

/// Replaces what a file says between `<!-- NAME:begin -->` and `<!-- NAME:end -->`.
///
/// # Errors
/// When the file cannot be read or written, or lacks the marks.
pub fn write(file: &Path, name: &str, text: &str) -> anyhow::Result<()> {
    let page = std::fs::read_to_string(file).with_context(|| format!("reading {}", file.display()))?;
    let page = replaced(&page, name, text).with_context(|| format!("writing into {}", file.display()))?;
    std::fs::write(file, page).with_context(|| format!("writing {}", file.display()))
}

fn replaced(page: &str, name: &str, text: &str) -> anyhow::Result<String> {
    let (begin, end) = (format!("<!-- {name}:begin -->"), format!("<!-- {name}:end -->"));
    let Some((before, rest)) = page.split_once(&begin) else { bail!("there is no line `{begin}`; add one") };
    let Some((_, after)) = rest.split_once(&end) else { bail!("no line `{end}` follows `{begin}`; add one") };
    Ok(format!("{before}{begin}\n{}\n{end}{after}", text.trim_end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_marked_part_changes() {
        let page = "above\n<!-- x:begin -->\nold\n<!-- x:end -->\nbelow\n";
        let new = replaced(page, "x", "new\n").unwrap();
        assert_eq!(new, "above\n<!-- x:begin -->\nnew\n<!-- x:end -->\nbelow\n");
        assert_eq!(replaced(&new, "x", "new\n").unwrap(), new);
    }

    #[test]
    fn missing_marks_are_named() {
        let missing = |page: &str| replaced(page, "x", "new").unwrap_err().to_string();
        assert!(missing("no marks").contains("x:begin"));
        assert!(missing("<!-- x:begin -->").contains("x:end"));
    }
}
