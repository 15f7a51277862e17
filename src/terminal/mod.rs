//! What is printed, and how: lines and tables, what happens during a run, the exit code. Knows no
//! commands.

pub mod exit;
pub mod output;
pub mod progress;
