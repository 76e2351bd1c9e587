//! Matchers: each a composition of the lattice kernels, a rule and the common answer.

pub mod posterior;
