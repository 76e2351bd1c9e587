//! How the navigator stands to the map: its status, and why.

use super::integrity::axes;
use super::outcome::{NavigatorOutcome, NavigatorStatus, Reason};
use super::state::{Navigator, Newest};

/// Time without a usable reading after which the navigator coasts, seconds.
const COASTING_S: f64 = 60.0;
/// Position sigma, in ranges over which the field is straight, beyond which the navigator is lost, and below which it is found again.
const LOST: f64 = 4.0;
const FOUND: f64 = 2.0;

impl Navigator {
    /// Sets the status after a correction between two steps.
    pub(super) fn judge_again(&mut self) {
        if let Some(now) = self.state.newest {
            self.judge(&now, NavigatorOutcome::Waiting);
        }
    }

    /// Sets the status.
    pub(super) fn judge(&mut self, now: &Newest, outcome: NavigatorOutcome) {
        let sigma = axes(self.reported_m2())[0];
        let range = self.law.linear_m;
        let was_lost = self.state.status == NavigatorStatus::Lost;
        let silent = self.state.heard_s.is_none_or(|t| now.time_s - t > COASTING_S);
        let limit = if !self.state.tracked {
            range
        } else if was_lost {
            FOUND * range
        } else {
            LOST * range
        };
        (self.state.status, self.state.reason) = if sigma > limit {
            if self.state.tracked {
                (NavigatorStatus::Lost, Reason::Uncertain)
            } else {
                (NavigatorStatus::Acquiring, Reason::StartUncertain)
            }
        } else if silent {
            let reason = match (self.state.off_map, self.state.is_stuck) {
                (true, _) => Reason::OffMap,
                (false, true) => Reason::StuckSensor,
                (false, false) => Reason::NoReading,
            };
            (NavigatorStatus::Coasting, reason)
        } else if self.state.is_stuck {
            (NavigatorStatus::Coasting, Reason::StuckSensor)
        } else if outcome == NavigatorOutcome::OffMap {
            (NavigatorStatus::Coasting, Reason::OffMap)
        } else {
            self.state.tracked = true;
            (NavigatorStatus::Tracking, Reason::Readings)
        };
    }
}
