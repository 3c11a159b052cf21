//! Ctrl-C: the first ends the work in order, the second at once.
//!
//! A first SIGINT or SIGTERM only raises the context's flag: files that are being written become
//! whole, a render ends with what it has, and nothing new is begun. The second ends the program where
//! it is, and may leave a temporary file (`.platelight-…`) behind.

use std::sync::{Arc, atomic::AtomicBool};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use crate::render::Context;

/// What a shell shows of a program that the signal killed: 128 and its number.
const EXIT_CODES: [(i32, i32); 2] = [(SIGINT, 130), (SIGTERM, 143)];

/// Makes signals cancel `context`.
///
/// # Errors
/// The system knows no such signals; they then end the program at once, as without this.
pub fn cancel_on_signals(context: &Context) -> std::io::Result<()> {
    for (signal, exit_code) in EXIT_CODES {
        // In this order: from the first line on no signal is lost, and the first of them finds
        // `again` down and passes on to raise it.
        flag::register(signal, context.flag())?;
        let again = Arc::new(AtomicBool::new(false));
        flag::register_conditional_shutdown(signal, exit_code, Arc::clone(&again))?;
        flag::register(signal, again)?;
    }
    // A file beyond the shell's limit (ulimit -f) is a failed write, with a message and nothing half
    // written, not the end of the program.
    #[cfg(unix)]
    flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false)))?;
    Ok(())
}
