//! The supervision of a robot: every datagram from and to the robot passes here, and a STOP does not wait for the program.
//!
//! The caller passes each received datagram to [`Supervisor::take`], and sends what [`Supervisor::act`] writes, again and
//! again until it writes nothing: after each datagram, and at least every millisecond while the needle may move. It is
//! the same code in real time, where a thread calls it that never waits for the program, and in virtual time.
//!
//! The program posts its state of the guard, the times at which its devices took their last samples, and that its loop
//! runs. From the samples of the robot and from the age of what was posted, the supervisor decides with [`validated`],
//! the same transitions as those of the program:
//!
//! 1. It sends a STOP at once, and repeats it until the robot says that it stands.
//! 2. After its own STOP (a *trip*) it sends no motion until the program has posted a state that knows of the trip.
//! 3. It sends a motion only while the guard is enabled or a person retracts the needle.
//! 4. It sends heartbeats only while the loop of the program runs.
//!
//! A program without a guard posts nothing: its datagrams are sent as they are, and nothing is decided here.

use crate::advance::validated;
use crate::age::{Delay, Freshness, freshness};
use crate::cause::{Cause, Causes};
use crate::datagram::{Kind, LONGEST, Status};
use crate::repeat::{Heartbeat, RepeatedStop};
use crate::session::{Message, Session, is_later};
use crate::state::{Operating, Report, State};
use crate::{NEVER, Nanoseconds, is_older};

/// Limits that the supervisor watches. An age limit that is infinite is not watched.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// Largest age of a status (s).
    pub stage_age_s: f64,
    /// Longest time between two signs of life of the loop (s).
    pub loop_age_s: f64,
    /// Largest age of a force sample (s).
    pub force_age_s: f64,
    /// Largest age of a pose (s).
    pub pose_age_s: f64,
    /// Largest age of a signal of the deadman switch (s).
    pub deadman_age_s: f64,
    /// Range of depths that may be measured (mm).
    pub depth_mm: (f64, f64),
    /// Largest velocities that may be measured, inward and outward (mm/s).
    pub velocity_mm_s: (f64, f64),
    /// Largest roll that may be measured, to either side (rad).
    pub roll_rad: f64,
}

/// Times of the samples of a device that the program reads.
#[derive(Clone, Copy, Debug)]
pub struct Timed {
    /// Time at which the device took its last sample; [`NEVER`] before the first.
    pub taken_ns: Nanoseconds,
    /// Time at which it took its last usable sample.
    pub usable_ns: Nanoseconds,
    /// Whether the device saw nothing in its last sample.
    pub is_unseen: bool,
}

impl Default for Timed {
    fn default() -> Timed {
        Timed { taken_ns: NEVER, usable_ns: NEVER, is_unseen: false }
    }
}

/// What the program posts: its state of the guard, and the times of its inputs.
#[derive(Clone, Copy, Debug)]
pub struct Post {
    /// State of the guard.
    pub state: State,
    /// Number of trips that the program knew when it decided this state; None for a person's order, which counts.
    pub trips: Option<u32>,
    /// Force samples.
    pub force: Timed,
    /// Poses.
    pub pose: Timed,
    /// Time at which a person last held the deadman switch.
    pub deadman_ns: Nanoseconds,
}

/// A STOP that the supervisor has decided without the program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Trip {
    /// Number of trips so far.
    pub count: u32,
    /// Causes of the last trip.
    pub causes: Causes,
    /// Time of the last trip.
    pub time_ns: Nanoseconds,
}

#[derive(Clone, Copy, Debug)]
struct Guarded {
    rules: Rules,
    post: Post,
    ticked_ns: Nanoseconds,
}

/// A session with a robot, and the guard of its motions.
#[derive(Clone)]
pub struct Supervisor {
    /// The session.
    pub session: Session,
    trip: Trip,
    guarded: Option<Guarded>,
    lease_ns: Nanoseconds,
    heartbeat: Heartbeat,
    stop: RepeatedStop,
    stop_number: Option<u32>,
    last: Option<Status>,
    delay: Delay,
    taken_ns: Nanoseconds,
    usable_ns: Nanoseconds,
}

impl Supervisor {
    /// A supervisor of a session, without a guard.
    #[must_use]
    pub fn new(session: Session, now_ns: Nanoseconds) -> Supervisor {
        Supervisor {
            session,
            trip: Trip::default(),
            guarded: None,
            lease_ns: NEVER,
            heartbeat: Heartbeat { sent_ns: now_ns },
            stop: RepeatedStop::default(),
            stop_number: None,
            last: None,
            delay: Delay::default(),
            taken_ns: NEVER,
            usable_ns: NEVER,
        }
    }

    /// Begin another session with the same robot. Its guard must post its state again. Trips are counted on, and the
    /// delay of samples is still measured from the fastest one.
    pub fn begin(&mut self, session: Session, now_ns: Nanoseconds) {
        let (trip, delay) = (self.trip, self.delay);
        *self = Supervisor { trip, delay, ..Supervisor::new(session, now_ns) };
    }

    /// The last trip.
    #[must_use]
    pub fn trip(&self) -> Trip {
        self.trip
    }

    /// Take over what the program posts, with the limits in force.
    ///
    /// A state that was decided without knowledge of the last trip does not count: the program must see the trip first.
    pub fn post(&mut self, rules: Rules, mut post: Post, now_ns: Nanoseconds) {
        let before = self.guarded;
        if post.trips.is_some_and(|trips| trips != self.trip.count)
            && let Some(before) = before
        {
            post.state = before.post.state;
        }
        let ticked_ns = before.map_or(now_ns, |before| before.ticked_ns);
        self.guarded = Some(Guarded { rules, post, ticked_ns });
    }

    /// Note that the loop of the program runs: it may be silent for `loop_age_s`, and heartbeats are sent meanwhile.
    pub fn tick(&mut self, now_ns: Nanoseconds) {
        if let Some(guarded) = &mut self.guarded {
            guarded.ticked_ns = now_ns;
            self.lease_ns = now_ns.saturating_add((guarded.rules.loop_age_s * 1e9) as Nanoseconds);
        }
    }

    /// Send no heartbeat until the next [`Supervisor::tick`].
    pub fn withhold(&mut self) {
        self.lease_ns = NEVER;
    }

    /// The causes for a stop that the supervisor sees.
    #[must_use]
    pub fn causes(&self, now_ns: Nanoseconds) -> Causes {
        let Some(Guarded { rules, post, ticked_ns }) = &self.guarded else { return Causes::NONE };
        let mut causes = self.of_motion(rules);
        if post.state.operating != Operating::Enabled {
            return causes;
        }
        causes |= self.of_stage(rules.stage_age_s, now_ns);
        let force = [Cause::ForceStale, Cause::ForceSuspect];
        let pose = [Cause::PoseStale, if post.pose.is_unseen { Cause::PoseUnseen } else { Cause::PoseSuspect }];
        causes |= aged(&post.force, rules.force_age_s, now_ns, force);
        causes |= aged(&post.pose, rules.pose_age_s, now_ns, pose);
        causes |= late(post.deadman_ns, rules.deadman_age_s, now_ns, Cause::DeadmanReleased);
        causes | late(*ticked_ns, rules.loop_age_s, now_ns, Cause::LoopLate)
    }

    /// The causes that the age of the samples of the robot gives.
    #[must_use]
    pub fn of_stage(&self, stage_age_s: f64, now_ns: Nanoseconds) -> Causes {
        let is_fault = self.last.is_some_and(|last| last.state == Status::FAULT);
        let has_failed = is_fault || self.session.lost_control.is_some();
        match freshness(has_failed, self.taken_ns, self.usable_ns, stage_age_s, now_ns) {
            Freshness::Fresh => Causes::NONE,
            Freshness::Failed => Cause::StageFault.into(),
            Freshness::Stale => Cause::StageStale.into(),
            Freshness::Unusable => Cause::StageSuspect.into(),
        }
    }

    fn of_motion(&self, rules: &Rules) -> Causes {
        let Some(last) = self.last else { return Causes::NONE };
        let (shallowest_mm, deepest_mm) = rules.depth_mm;
        let (inward_mm_s, outward_mm_s) = rules.velocity_mm_s;
        let fastest_mm_s = if last.velocity_mm_s > 0.0 { inward_mm_s } else { outward_mm_s };
        let mut causes = Causes::NONE;
        if last.depth_mm < shallowest_mm || last.depth_mm > deepest_mm {
            causes |= Cause::DepthExceeded.into();
        }
        if last.velocity_mm_s.abs() > fastest_mm_s {
            causes |= Cause::Overspeed.into();
        }
        if last.roll_rad.abs() > rules.roll_rad {
            causes |= Cause::RollExceeded.into();
        }
        causes
    }

    /// Take a datagram of the robot.
    pub fn take(&mut self, datagram: &[u8], now_ns: Nanoseconds) -> Message {
        let message = self.session.take(datagram, now_ns);
        if let Message::Status(status, _) = message {
            self.see(status, now_ns);
        }
        message
    }

    fn see(&mut self, status: Status, now_ns: Nanoseconds) {
        self.delay = self.delay.then(now_ns, status.head.sent_ns as f64 * 1e-9);
        self.taken_ns = now_ns.saturating_sub((self.delay.late_s * 1e9) as Nanoseconds);
        if status.is_finite() {
            self.usable_ns = self.taken_ns;
            self.last = Some(status);
        } else if let Some(last) = &mut self.last {
            last.state = status.state;
        }
        // A stop that the robot has accepted is repeated until the robot says that it stands.
        if let Some(number) = self.stop_number
            && !is_later(number, status.head.number)
            && status.is_standing()
        {
            self.stop_number = None;
        }
    }

    /// Decide whether to stop now.
    fn validate(&mut self, now_ns: Nanoseconds) {
        let causes = self.causes(now_ns);
        let Some(guarded) = &mut self.guarded else { return };
        if causes.is_empty() {
            return;
        }
        let before = guarded.post.state;
        let (is_busy, is_retracting) = (before.is_busy, before.is_retracting());
        let report = Report { causes: causes | before.present, is_busy, is_retracting, is_resting: false };
        let transition = validated(before, report, now_ns);
        guarded.post.state = transition.state;
        if transition.stops {
            self.trip = Trip { count: self.trip.count.wrapping_add(1), causes, time_ns: now_ns };
            self.stop_number = Some(self.session.last_number());
            self.stop = RepeatedStop::default();
        }
    }

    /// Decide what is to be sent now; write the next datagram and return its size, 0 if nothing is to be sent.
    pub fn act(&mut self, now_ns: Nanoseconds, bytes: &mut [u8; LONGEST]) -> usize {
        self.validate(now_ns);
        if self.stop_number.is_some() && self.stop.is_due(now_ns) {
            let number = self.session.next_number();
            self.stop_number = Some(number);
            self.stop.end(now_ns, now_ns, true);
            return self.session.encode(Kind::Stop, number, 0, (0.0, 0.0), now_ns, bytes);
        }
        if now_ns < self.lease_ns && self.heartbeat.take(now_ns) {
            let deadline_ns = self.session.deadline_ns(self.session.silence_ns(), now_ns);
            return self.session.encode(Kind::Alive, 0, deadline_ns, (0.0, 0.0), now_ns, bytes);
        }
        0
    }

    /// Write a datagram of the program and return its size; 0 if it must not be sent now.
    pub fn command(
        &mut self,
        kind: Kind,
        number: u32,
        deadline_ns: u64,
        target: (f64, f64),
        now_ns: Nanoseconds,
        bytes: &mut [u8; LONGEST],
    ) -> usize {
        if let Some(guarded) = &self.guarded {
            let state = &guarded.post.state;
            if kind.is_motion() {
                let may_move = state.operating == Operating::Enabled || state.is_retracting();
                // A motion that is sent again does not undo a stop that was ordered after it.
                let is_overtaken = self.stop_number.is_some_and(|stop| !is_later(number, stop));
                if !may_move || is_overtaken {
                    return 0;
                }
                self.stop_number = None;
            }
            if kind == Kind::Stop {
                self.stop_number = Some(number);
                self.stop.end(now_ns, now_ns, true);
            }
        }
        if kind == Kind::Goodbye {
            self.stop_number = None;
            self.withhold();
        }
        self.session.encode(kind, number, deadline_ns, target, now_ns, bytes)
    }
}

fn aged(times: &Timed, limit_s: f64, now_ns: Nanoseconds, [stale, unusable]: [Cause; 2]) -> Causes {
    match freshness(false, times.taken_ns, times.usable_ns, limit_s, now_ns) {
        _ if limit_s == f64::INFINITY => Causes::NONE,
        Freshness::Stale => stale.into(),
        Freshness::Unusable => unusable.into(),
        Freshness::Fresh | Freshness::Failed => Causes::NONE,
    }
}

fn late(moment_ns: Nanoseconds, limit_s: f64, now_ns: Nanoseconds, cause: Cause) -> Causes {
    if limit_s < f64::INFINITY && is_older(moment_ns, limit_s, now_ns) { cause.into() } else { Causes::NONE }
}
