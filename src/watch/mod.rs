//! A run in a browser: what each stage does, its curves and its pictures, on a page of this
//! machine's loopback that fills in while the run goes.
//!
//! The run tells a dashboard what happens; pages get its changes as they come, and ask for
//! pictures when stages have left some. Knows nothing of what stages compute.

mod dashboard;
mod page;
mod pictures;
mod server;
mod watched;

pub use watched::Watched;
