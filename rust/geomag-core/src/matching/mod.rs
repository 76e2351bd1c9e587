//! Matchers: each a composition of the lattice kernels, a rule and the common answer.

pub mod grid_search;
pub mod iema;
pub mod posterior;
pub mod similarity;
