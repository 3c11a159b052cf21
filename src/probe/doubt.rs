//! Reasons not to trust a ball that was found, and how they are told.

use super::find::{BallImage, HINT_SIGMA};

/// A reason not to trust a ball that was found, in words without the name of the hint's key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Doubt {
    /// The rim could not be measured; the hint was taken as it is.
    HintTaken,
    /// Another place looks nearly as much like a ball: centre and radius, px.
    Rival([f64; 3]),
    /// Its outline is little rounder than other things are: score and agreement of the rim, 0…1.
    Weak { score: f64, agreement: f64 },
    /// All beside it is black.
    BeforeBlack,
}

impl Doubt {
    /// All reasons to doubt this one: it may not be the ball, or not be where it is said to be.
    pub fn about(ball: &BallImage) -> Vec<Self> {
        let hint_taken = ball.score.is_none().then_some(Self::HintTaken);
        let weak = ball.score.zip(ball.agreement).filter(|_| ball.is_weak());
        hint_taken
            .into_iter()
            .chain(ball.rival_px.map(Self::Rival))
            .chain(weak.map(|(score, agreement)| Self::Weak { score, agreement }))
            .chain(ball.before_black.then_some(Self::BeforeBlack))
            .collect()
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
            Self::Weak { score, agreement } => format!(
                "what was taken for the ball stands out little (by {score:.2}), or its edges lie on one circle along \
                 little of it ({:.0} %): look at the overlay, and give {hint} if it is something else",
                100.0 * agreement
            ),
            Self::BeforeBlack => {
                "there is nothing but black beside the ball: fine if it was cut out; a fisheye's \
                                  picture, which looks so too, must be given as one"
                    .to_owned()
            }
        }
    }

    /// What it may do to the light.
    pub fn effect(self) -> String {
        match self {
            Self::HintTaken => format!(
                "directions off by {} % of the ball's radius, if the hint is good to that",
                100.0 * HINT_SIGMA
            ),
            Self::Rival(_) | Self::Weak { .. } | Self::BeforeBlack => {
                "all of the light, if it is not the ball".to_owned()
            }
        }
    }
}
