//! Reasons not to trust a ball that was found, and how they are told.

use super::find::{BallImage, HINT_SIGMA};

/// A reason not to trust a ball that was found, in words without the name of the hint's key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Doubt {
    /// The rim could not be measured; the hint was taken as it is.
    HintTaken,
    /// Another place looks nearly as much like a ball: centre and radius, px.
    Rival([f64; 3]),
}

impl Doubt {
    /// All reasons to doubt this one: it may not be the ball, or not be where it is said to be.
    pub fn about(ball: &BallImage) -> Vec<Self> {
        let hint_taken = ball.score.is_none().then_some(Self::HintTaken);
        hint_taken.into_iter().chain(ball.rival_px.map(Self::Rival)).collect()
    }

    /// What was found and what to do; `hint` is what the hint is called where it is given.
    pub fn sentence(self, hint: &str) -> String {
        match self {
            Self::HintTaken => format!(
                "the ball's rim could not be measured; {hint} is taken as it is: look at the overlay"
            ),
            Self::Rival([u, v, r]) => format!(
                "another place looks nearly as much like a ball: centre {u:.0}, {v:.0}, radius {r:.0} px; \
                 look at the overlay, and give {hint} if the wrong one was taken"
            ),
        }
    }

    /// What it may do to the light.
    pub fn effect(self) -> String {
        match self {
            Self::HintTaken => format!(
                "directions off by {} % of the ball's radius, if the hint is good to that",
                100.0 * HINT_SIGMA
            ),
            Self::Rival(_) => "all of the light, if the wrong one was taken".to_owned(),
        }
    }
}
