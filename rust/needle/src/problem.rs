//! A steering problem: its description, and the Markov decision process made from it.

use ppvi::Result;
use ppvi::lattice::{LatticeMdp, LatticeParts};

use crate::classification::Classifier;
use crate::regions::TissueRegions;
use crate::setup::Setup;

/// A [`Setup`] and its lattice, which belong together.
#[derive(Debug, Clone)]
pub struct SteeringProblem {
    setup: Setup,
    lattice: LatticeMdp,
}

impl SteeringProblem {
    /// Validates the setup and determines the outcome of every step, in parallel on the current rayon pool.
    ///
    /// # Errors
    /// The errors of [`Setup::shape`] and of [`LatticeMdp::new`], and [`ppvi::Error::Parameter`] for more than 256
    /// radii of curvature.
    pub fn new(setup: Setup) -> Result<Self> {
        let shape = setup.shape()?;
        let regions = TissueRegions::new(&setup, shape)?;
        let parts = LatticeParts {
            shape,
            spacing: setup.spacing,
            transition: setup.transition,
            costs: setup.costs,
            regions: regions.curved.steps.clone(),
            straight: regions.straight.steps.clone(),
            region_of: regions.region_of.clone(),
        };
        let classifier = Classifier::new(&setup, shape, &regions);
        let write = |motion, k, bevel, codes: &mut [u8]| classifier.write_outcomes(motion, k, bevel, codes);
        let lattice = LatticeMdp::new(parts, write)?;
        Ok(SteeringProblem { setup, lattice })
    }

    /// The description.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// The Markov decision process.
    pub fn lattice(&self) -> &LatticeMdp {
        &self.lattice
    }
}
