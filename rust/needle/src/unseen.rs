//! Tip noise that the controller does not know yet.
//!
//! It knows the pose of a coil behind the tip, and how the needle was rotated since. It believes the tip to be where it would
//! be without the noise on the length up to the coil.

use crate::lookup::Pose;
use crate::surroundings::Truth;

/// A turn of the heading by tip noise, at a point of the path and its length, mm.
struct Kick {
    at: [f64; 2],
    turn: f64,
    length: f64,
}

/// What is true in an execution, with the tip noise that the controller does not know yet.
pub(crate) struct Unseen {
    given: Truth,
    /// From the believed pose to that in the anatomy.
    pub truth: Truth,
    /// From the believed pose to that of the tip in the plan.
    motion: Truth,
    length: f64,
    kicks: Vec<Kick>,
}

impl Unseen {
    pub(crate) fn new(given: Truth) -> Unseen {
        let motion = Truth { turn: 0.0, shift: [0.0; 2], ..given };
        Unseen { given, truth: given, motion, length: 0.0, kicks: vec![] }
    }

    /// Whether the controller learns the tip noise late.
    pub(crate) fn is_late(&self) -> bool {
        self.given.behind > 0.0
    }

    /// The believed pose after a length, at whose end tip noise turns the tip; `believed` is that before the turn.
    pub(crate) fn turned(&mut self, believed: Pose, length: f64, turn: f64) -> Pose {
        let mut tip = self.motion.pose(believed);
        self.length += length;
        tip.heading += turn;
        self.kicks.push(Kick { at: [tip.x, tip.y], turn, length: self.length });
        let believed = self.believed(tip);
        self.motion = self.motion.between(believed, tip);
        self.truth = self.given.between(believed, self.given.pose(tip));
        believed
    }

    /// The pose of the tip without the noise ahead of the coil: each turn is undone about its point.
    fn believed(&self, tip: Pose) -> Pose {
        let late = self.kicks.iter().rev().take_while(|kick| self.length - kick.length < self.given.behind);
        late.fold(tip, |tip, Kick { at: [x, y], turn, .. }| {
            let ((sin, cos), [dx, dy]) = ((-turn).sin_cos(), [tip.x - x, tip.y - y]);
            Pose {
                x: x + cos * dx - sin * dy,
                y: y + sin * dx + cos * dy,
                heading: tip.heading - turn,
                bevel: tip.bevel,
            }
        })
    }
}
