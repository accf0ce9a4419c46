//! Signals: the first SIGTERM or SIGINT asks the work to end, a second SIGINT ends the process at once.
//!
//! A second SIGTERM does nothing: schedulers send it again and again, to every process of a job and to its group, and mean
//! no more by it than by the first. Who presses Ctrl-C twice does not want to wait.
//!
//! What works in blocks asks [`caught`] between them, through [`Terminal`](super::progress::Terminal), and ends in
//! order: temporary files are removed, rows are in the checkpoint. What takes longer (the build of a large tree, one huge
//! file) does not ask, so a watcher ends the process after a grace: that is as safe as a power cut, since nothing is
//! in its place before it is whole.

use std::{
    io,
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicBool, AtomicI32, Ordering},
    },
};

use signal_hook::{
    consts::{SIGINT, SIGTERM},
    flag,
};

/// From the signal to the end of the process, if the work does not end before.
#[cfg(unix)]
const GRACE: std::time::Duration = std::time::Duration::from_millis(1500);

/// Whether there is work that asks.
static ASKED: AtomicBool = AtomicBool::new(false);

/// The first signal; 0: none.
static CAUGHT: AtomicI32 = AtomicI32::new(0);

/// What to tell of interrupted work.
static REMEDY: Mutex<String> = Mutex::new(String::new());

/// Has SIGTERM and SIGINT caught from now on, and failed writes told by errors instead of SIGXFSZ.
///
/// # Errors
/// The system refuses handlers or a thread.
pub fn install() -> io::Result<()> {
    static AGAIN: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    let again = AGAIN.get_or_init(Arc::default);
    // In this order: the first SIGINT finds the flag down and raises it, the second finds it up.
    flag::register_conditional_shutdown(SIGINT, code(SIGINT).into(), Arc::clone(again))?;
    flag::register(SIGINT, Arc::clone(again))?;
    #[cfg(unix)]
    watch()?;
    Ok(())
}

#[cfg(unix)]
fn watch() -> io::Result<()> {
    use signal_hook::{consts::SIGXFSZ, iterator::Signals, low_level};

    // A flag that nobody reads: what counts is that the signal does not kill, so that the write fails with its reason.
    flag::register(SIGXFSZ, Arc::default())?;
    let mut signals = Signals::new([SIGTERM, SIGINT])?;
    let watcher = move || {
        let Some(signal) = signals.forever().next() else { return };
        CAUGHT.store(signal, Ordering::Relaxed);
        if ASKED.load(Ordering::Relaxed) {
            std::thread::sleep(GRACE);
        }
        super::complain(&message(signal));
        // Without the exit handlers of libraries, whose threads are still at work.
        low_level::exit(code(signal).into());
    };
    std::thread::Builder::new().name("signals".into()).spawn(watcher).map(drop)
}

/// From now on there is work that asks: it has time to end in order.
pub fn grant_grace() {
    ASKED.store(true, Ordering::Relaxed);
}

/// The signal that asked for the end, if one did.
pub fn caught() -> Option<i32> {
    Some(CAUGHT.load(Ordering::Relaxed)).filter(|&signal| signal != 0)
}

/// The exit code that tells of a signal, as that of a shell does.
pub fn code(signal: i32) -> u8 {
    128 + signal as u8
}

/// What is told after a signal.
pub fn message(signal: i32) -> String {
    let name = if signal == SIGINT { "SIGINT" } else { "SIGTERM" };
    let remedy = REMEDY.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let remedy = if remedy.is_empty() { "no result was written" } else { &remedy };
    format!("interrupted by {name}: {remedy}")
}

/// Says how interrupted work is taken up again.
pub fn set_remedy(remedy: String) {
    *REMEDY.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = remedy;
}
