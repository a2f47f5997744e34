//! A supervisor beside a robot.

use needleplan_guard::cause::{Causes, Owner};
use needleplan_guard::datagram::{Kind, LONGEST, SessionLimits};
use needleplan_guard::session::{Message, Session};
use needleplan_guard::state::{Operating, State};
use needleplan_guard::supervisor::{Post, Rules, Supervisor, Timed};
use needleplan_guard::{NEVER, Nanoseconds};

use super::Robot;

pub const MS: Nanoseconds = 1_000_000;

pub fn rules() -> Rules {
    Rules {
        stage_age_s: 0.03,
        loop_age_s: 0.045,
        force_age_s: 0.03,
        pose_age_s: 0.045,
        deadman_age_s: f64::INFINITY,
        depth_mm: (-1.0, 100.0),
        velocity_mm_s: (15.0, 30.0),
        roll_rad: 25.0,
    }
}

pub struct Bench {
    pub supervisor: Supervisor,
    pub robot: Robot,
    pub post: Post,
    pub rules: Rules,
    pub now_ns: Nanoseconds,
}

impl Bench {
    /// A bench without a guard.
    pub fn new() -> Bench {
        let now_ns = 1_000 * MS;
        let limits = SessionLimits { silence_us: 30_000, ..SessionLimits::default() };
        let state = State { operating: Operating::Enabled, motion: Some(Owner::Loop), ..State::default() };
        let timed = Timed { taken_ns: now_ns, usable_ns: now_ns, is_unseen: false };
        Bench {
            supervisor: Supervisor::new(Session::new(7, limits, None, now_ns), now_ns),
            robot: Robot { session: 7, ..Robot::default() },
            post: Post { state, trips: Some(0), force: timed, pose: timed, deadman_ns: NEVER },
            rules: rules(),
            now_ns,
        }
    }

    /// A bench with a guard that is enabled.
    pub fn enabled() -> Bench {
        Bench::counted(0)
    }

    /// A bench with a guard that is enabled, in a session in which both sides have counted so far.
    pub fn counted(count: u32) -> Bench {
        let mut bench = Bench::new();
        bench.supervisor.session = bench.supervisor.session.counting_from(count);
        (bench.robot.sequence, bench.robot.number) = (count, count);
        bench.says();
        bench.posts();
        bench.supervisor.tick(bench.now_ns);
        bench
    }

    /// The robot sends a status.
    pub fn says(&mut self) {
        let datagram = self.robot.status(self.now_ns);
        assert!(matches!(self.supervisor.take(&datagram, self.now_ns), Message::Status(..)));
    }

    /// The program posts its state.
    pub fn posts(&mut self) {
        self.supervisor.post(self.rules, self.post, self.now_ns);
    }

    /// Times of a device whose last sample is of now.
    pub fn fresh(&self) -> Timed {
        Timed { taken_ns: self.now_ns, usable_ns: self.now_ns, is_unseen: false }
    }

    /// The inputs of the program are fresh, and its loop runs.
    pub fn lives(&mut self) {
        self.post = Post { force: self.fresh(), pose: self.fresh(), ..self.post };
        self.posts();
        self.supervisor.tick(self.now_ns);
    }

    /// Kinds of what is sent now.
    pub fn sent(&mut self) -> Vec<u8> {
        let (mut bytes, mut kinds) = ([0; LONGEST], Vec::new());
        while self.supervisor.act(self.now_ns, &mut bytes) > 0 {
            kinds.push(bytes[5]);
        }
        kinds
    }

    /// What is sent in the next milliseconds, with the time since now (ms); `happen` comes before each.
    pub fn sent_within(&mut self, milliseconds: i64, happen: impl Fn(&mut Bench)) -> Vec<(i64, u8)> {
        let begin_ns = self.now_ns;
        let mut sent = Vec::new();
        for passed in 1..=milliseconds {
            self.now_ns = begin_ns + passed * MS;
            happen(self);
            sent.extend(self.sent().into_iter().map(|kind| (passed, kind)));
        }
        sent
    }

    pub fn passes(&mut self, kind: Kind) -> bool {
        let number = self.supervisor.session.next_number();
        self.supervisor.command(kind, number, 0, (1.0, 1.0), self.now_ns, &mut [0; LONGEST]) > 0
    }

    pub fn trip(&self) -> (u32, Causes) {
        (self.supervisor.trip().count, self.supervisor.trip().causes)
    }
}
