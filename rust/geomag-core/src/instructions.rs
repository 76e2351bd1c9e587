//! Which instruction set the kernels run with: the best that the machine has, or a lesser one by the environment.
//!
//! Sums are ordered by the width of the vectors, and a fused multiply-add rounds once, so answers of different sets differ in their
//! last digits. Holding a fast machine to the set of a slow one shows by how much.

use std::sync::OnceLock;

use pulp::Arch;

use crate::error::{Error, Result};

/// The environment variable that holds the kernels to one of [`available`], read once.
pub const VARIABLE: &str = "GEOMAG_INSTRUCTION_SET";

/// Instruction sets of this machine, by name, the least first: `scalar`, then `x86-64-v3` (AVX2 and FMA), `x86-64-v4` (AVX-512) or `neon`.
pub fn available() -> Vec<&'static str> {
    sets().into_iter().map(|(name, _)| name).collect()
}

fn sets() -> Vec<(&'static str, Arch)> {
    #[allow(unused_mut)]
    let mut sets = vec![("scalar", Arch::Scalar)];
    #[cfg(target_arch = "x86_64")]
    {
        sets.extend(pulp::x86::V3::try_new().map(|simd| ("x86-64-v3", Arch::V3(simd))));
        sets.extend(pulp::x86::V4::try_new().map(|simd| ("x86-64-v4", Arch::V4(simd))));
    }
    #[cfg(target_arch = "aarch64")]
    sets.extend(pulp::aarch64::Neon::try_new().map(|simd| ("neon", Arch::Neon(simd))));
    sets
}

/// What was asked for, or why it cannot be had.
fn asked() -> Result<(&'static str, Arch)> {
    let mut sets = sets();
    let Some(wanted) = std::env::var_os(VARIABLE) else {
        return sets.pop().ok_or_else(|| Error::invalid(VARIABLE, "an instruction set", "none"));
    };
    sets.iter().find(|(name, _)| *name == wanted).copied().ok_or_else(|| {
        Error::invalid(VARIABLE, format!("one of this machine's {:?}", available()), wanted.to_string_lossy())
    })
}

static CHOSEN: OnceLock<(&str, Arch)> = OnceLock::new();

/// The instruction set that the kernels run with.
pub fn chosen() -> Arch {
    CHOSEN.get_or_init(|| asked().unwrap_or(("scalar", Arch::Scalar))).1
}

/// Name of the instruction set that the kernels run with.
///
/// # Errors
/// [`Error::Invalid`] where the environment asks for one that this machine does not have; the kernels are `scalar` then.
pub fn instruction_set() -> Result<&'static str> {
    asked().map(|(name, _)| name)
}
