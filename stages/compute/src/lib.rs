//! Arrays on a device, and operators with explicit forward and backward.
