//! Tells which network a set of tensors makes, by their names and shapes.

use crate::compact::Compact;
use crate::error::UpsamplerError;
use crate::network::Network;
use crate::residual::Residual;
use crate::rrdb::{self, Rrdb};
use crate::span::Span;
use crate::tensors::Tensors;

/// The network that these tensors make, all of them. Fails where there is none, and names a tensor.
pub fn recognise(tensors: &mut Tensors) -> Result<Box<dyn Network>, UpsamplerError> {
    // Before anything is told apart: older ESRGAN files have the tensors under other names.
    rrdb::rename(tensors)?;
    let network: Box<dyn Network> = if Span::is(tensors) {
        Box::new(Span::read(tensors)?)
    } else if Rrdb::is(tensors) {
        Box::new(Rrdb::read(tensors)?)
    } else if Residual::is(tensors) {
        Box::new(Residual::read(tensors)?)
    } else if Compact::is(tensors) {
        Box::new(Compact::read(tensors)?)
    } else {
        let Some(first) = tensors.names().next() else {
            return Err(UpsamplerError::file(tensors.file(), "holds no tensors"));
        };
        let problem = "is of no network that is known here: those are SPAN, RRDBNet (ESRGAN, Real-ESRGAN), \
                       SRVGGNetCompact with PReLUs, and our own Residual";
        return Err(tensors.wrong(first, problem));
    };
    // A tensor that no layer wants means another network, whose results would be wrong in silence.
    tensors.finish(network.facts().family)?;
    Ok(network)
}
