//! From a pipeline's graph to results: the key of each stage, the plan of what to compute and why,
//! and the scheduler that has it computed. Knows stages by their trait alone, and no commands.

pub mod diff;
pub mod explain;
pub mod extension;
pub mod key;
pub mod peak;
pub mod plan;
pub mod scheduler;
pub mod task;
#[cfg(test)]
pub mod testing;
