//! The exit codes: what a command that has ended tells scripts. Knows no errors.

/// All went well.
pub const OK: u8 = 0;
/// A stage failed.
pub const FAILED: u8 = 1;
/// The command line makes no sense.
pub const USAGE: u8 = 2;
/// The pipeline, or something that it names, is not as it should be. Nothing was run.
pub const PIPELINE: u8 = 3;
/// The store, the output folder or standard output cannot be used.
pub const STORE: u8 = 4;
/// A check found something: damage, a difference, stages to run.
pub const FOUND: u8 = 5;
/// The run was interrupted; the same command goes on where it stopped.
// EX_TEMPFAIL of sysexits.h: a failure that passes, so that trying again makes sense.
pub const INTERRUPTED: u8 = 75;
/// A bug in the program.
// The code with which Rust's own panics end a program.
pub const BUG: u8 = 101;

/// All of them, for `--help`.
pub const HELP: &str = "\
Exit codes:
  0    all went well
  1    a stage failed
  2    the command line makes no sense
  3    the pipeline, or something it names, is not as it should be; nothing was run
  4    the store, the output folder or standard output cannot be used
  5    a check found something: damage, a difference, stages to run
  75   interrupted by a signal, with checkpoints kept; the same command goes on
  101  a bug in the program";
