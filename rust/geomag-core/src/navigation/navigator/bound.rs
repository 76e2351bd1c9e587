//! What a route would give: the bound of the position's covariance along it.

use super::integrity::RunningNis;
use super::outcome::Indicated;
use super::state::Navigator;
use crate::error::Result;

impl Navigator {
    /// The covariance that the position would have along a planned path, square metres, if readings come at every step that has a value
    /// (any number): the Cramer-Rao bound of the filter's own model, slopes taken at the truth, errors of the map and the sensor normal.
    ///
    /// Starts from what the navigator knows now; the navigator stays as it is.
    ///
    /// # Errors
    /// As [`Navigator::step`].
    pub fn predict_bound(&self, path: &[Indicated]) -> Result<Vec<[[f64; 2]; 2]>> {
        let mut ahead = self.clone();
        ahead.state.filter.mean_mut().fill(0.0);
        ahead.state.batch.clear();
        ahead.state.options.nu = f64::INFINITY;
        ahead.state.options.start = None;
        // What the vehicle will add on the way is not known: its coefficients stay as uncertain as they are.
        let terms = vec![0.0; ahead.state.options.terms()];
        ahead.state.options.matcher = None;
        ahead.state.running = RunningNis::new();
        if let (Some(newest), Some(first)) = (&mut ahead.state.newest, path.first()) {
            // The route need not begin where the vehicle is, nor at its time.
            (newest.time_s, newest.x, newest.y) = (first.time_s, self.field.wrap_x(first.x), first.y);
        }
        ahead.state.heard_s = None;
        ahead.exact_slopes = true;
        let mut out = Vec::with_capacity(path.len());
        for indicated in path {
            // What is read is what the map says: the mean stays where it is.
            let value = indicated.value.map(|_| ahead.expected(indicated));
            ahead.step_with_terms(&Indicated { value, ..*indicated }, &terms)?;
            ahead.state.filter.mean_mut().fill(0.0);
            out.push(ahead.own_m2());
        }
        Ok(out)
    }
}
