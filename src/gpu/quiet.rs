//! Filters harmless driver messages from standard error.

/// Start of a message of libwayland without XDG_RUNTIME_DIR: a layer of Mesa looks for a Wayland display, which is
/// not needed here.
#[cfg(any(target_os = "linux", test))]
const HARMLESS: &[u8] = b"error: XDG_RUNTIME_DIR is ";

/// Runs `work` and drops harmless lines from the process's standard error meanwhile.
#[cfg(target_os = "linux")]
pub(super) fn quietly<T>(work: impl FnOnce() -> T) -> T {
    // With the variable set there is no message.
    if std::env::var_os("XDG_RUNTIME_DIR").is_some_and(|folder| !folder.is_empty()) {
        return work();
    }
    // One filter at a time: a second would save the first one's pipe as standard error.
    static ONE: std::sync::Mutex<()> = std::sync::Mutex::new(());
    let _one = ONE.lock();
    // Without a filter all lines are printed.
    let filter = Filter::new();
    let done = work();
    drop(filter);
    done
}

/// Other systems print no such lines.
#[cfg(not(target_os = "linux"))]
pub(super) fn quietly<T>(work: impl FnOnce() -> T) -> T {
    work()
}

/// Redirects standard error through a pipe until it is dropped; a thread forwards the other end.
#[cfg(target_os = "linux")]
struct Filter {
    stderr: std::os::fd::OwnedFd,
    forwarded: std::sync::mpsc::Receiver<()>,
}

#[cfg(target_os = "linux")]
impl Filter {
    fn new() -> std::io::Result<Filter> {
        use std::os::fd::AsFd;

        let stderr = std::io::stderr().as_fd().try_clone_to_owned()?;
        let to = std::fs::File::from(stderr.try_clone()?);
        let (reader, writer) = std::io::pipe()?;
        let (done, forwarded) = std::sync::mpsc::channel();
        std::thread::Builder::new().name("stderr".to_owned()).spawn(move || {
            // Standard error itself failed: the error cannot be reported.
            let _ = forward(std::io::BufReader::new(reader), to);
            let _ = done.send(());
        })?;
        rustix::stdio::dup2_stderr(&writer)?;
        Ok(Filter { stderr, forwarded })
    }
}

#[cfg(target_os = "linux")]
impl Drop for Filter {
    fn drop(&mut self) {
        // Closes the pipe's last writer, unless a driver has started a process that inherited it.
        let _ = rustix::stdio::dup2_stderr(&self.stderr);
        let _ = self.forwarded.recv_timeout(std::time::Duration::from_millis(200));
    }
}

/// Copies all lines but the harmless ones.
#[cfg(any(target_os = "linux", test))]
fn forward(mut from: impl std::io::BufRead, mut to: impl std::io::Write) -> std::io::Result<()> {
    let mut line = Vec::new();
    while from.read_until(b'\n', &mut line)? > 0 {
        if !line.starts_with(HARMLESS) {
            to.write_all(&line)?;
        }
        line.clear();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::forward;

    #[test]
    fn only_harmless_lines_are_left_out() {
        let printed = b"one\nerror: XDG_RUNTIME_DIR is invalid or not set in the environment.\nerror: two\nhalf";
        let mut forwarded = Vec::new();
        forward(&printed[..], &mut forwarded).unwrap();
        assert_eq!(forwarded, b"one\nerror: two\nhalf");
    }
}
