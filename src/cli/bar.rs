//! Progress bars on standard error.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar, hidden unless standard error is a terminal, and in ASCII unless the locale is UTF-8.
pub(super) fn progress_bar(template: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template(template).expect("the template is valid");
    // Windows has no such variables, and its consoles support Unicode.
    let style = match cfg!(windows) || is_utf8(|name| std::env::var(name).ok()) {
        true => style,
        false => style.progress_chars("#>-"),
    };
    ProgressBar::no_length().with_style(style)
}

/// Whether the locale is UTF-8, by the first variable that is set (POSIX: LC_ALL, LC_CTYPE, LANG).
fn is_utf8(variable: impl Fn(&str) -> Option<String>) -> bool {
    let locale = ["LC_ALL", "LC_CTYPE", "LANG"].into_iter().filter_map(variable).find(|value| !value.is_empty());
    let locale = locale.unwrap_or_default().to_ascii_lowercase();
    locale.contains("utf-8") || locale.contains("utf8")
}

#[cfg(test)]
mod tests {
    use super::is_utf8;

    #[test]
    fn the_locale_decides() {
        let with = |variables: &[(&str, &str)]| {
            is_utf8(|name| {
                let mut matches = variables.iter().filter(|(known, _)| *known == name);
                matches.next().map(|(_, value)| (*value).to_owned())
            })
        };
        assert!(with(&[("LANG", "de_DE.UTF-8")]));
        assert!(with(&[("LANG", "C"), ("LC_CTYPE", "C.utf8")]));
        assert!(with(&[("LC_ALL", ""), ("LANG", "en_US.UTF-8")]));
        assert!(!with(&[("LC_ALL", "C"), ("LANG", "en_US.UTF-8")]));
        assert!(!with(&[("LANG", "de_DE.ISO-8859-1")]));
        assert!(!with(&[("LANG", "POSIX")]));
        assert!(!with(&[]));
    }
}
