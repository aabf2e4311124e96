"""What `sal-height figures --help` and `sal-height montecarlo --help` say."""

DEFAULT_TRIALS = 20_000
"""Of both commands."""

FIGURES = """Makes the SAL paper's figures 3 to 6 and 8 to 11 anew, and what the relief paper says: discriminator,
geometry, noise, hybrids, orders of accumulation, and heights tracked along range, which it leaves to Bayesian
filtering. Of the PSF paper, on synthetic tapes: responses of targets and of speckle, superposition, the point-spread
function with its echoes, and errors. In the output folder are, for each,
  NAME.csv     figure, curve, x, value, standard_error (0: no random numbers), closed_form (empty: no theory)
  NAME.png     the same axes and families of curves as the paper's; black dots are the closed forms
and
  checks.json  every point with a closed form: figure, curve, x, closed_form, value, standard_error, and z, their
               difference in standard errors; z is null without random numbers, where 1e-9 are allowed

Figures 3, 4, 8 and 9 are checked against quadrature, 5 and 6 against closed forms, 10 and 11 against the theory of high
CNR and many looks, where that holds, relief_* against closed forms and linear algebra, and psf_* against closed forms
and quadrature, at every fifth frequency; of psf_* one tape is made for every 1000 trials, 4 to 40. All points of a
figure share their draws, frequencies of psf_* excepted. Of the Monte Carlo points none should be 3 standard errors off
or more; by chance alone, in about one seed of three one is.

examples:
  sal-height figures                                   all of them, about two minutes
  sal-height figures fig5 fig6 --trials 200000 --seed 7 --out out/noise
"""

MONTE_CARLO = """Draws a target in noise again and again, has the estimator that the nodes run tell where it is, and
prints statistics with their standard errors (NAME_se). Angles are in beamwidths (wavelength / aperture diameter).

  pair    the discriminant of two detectors; --cnr-db is that of the sum channel at the target (figures 5 and 6)
  array   the elevation by all detectors; --cnr-db is that of one detector that looks straight at the target (figures 10
          and 11)

Both CNRs are of one look. See montecarlo pair --help and montecarlo array --help.
"""

STATISTICS = """What is printed:
  mean, median, std, s68, bias   s68 is half the width from 16 to 84 %; bias is that of the mean
  outlier_share                  of estimates more than 1 from the truth
  clipped_share                  of estimates that {clipped}; none is left out for it
  crb_conditional, _stochastic   Cramer-Rao bounds of known and of unknown Gaussian amplitudes
  crb_speckle                    the conditional one averaged over speckle; null (infinite) for one look
{more}"""

PAIR = STATISTICS.format(
    clipped="do not exist or whose modulus exceeds 1",
    more="""  kappa                          the discriminant without noise
  cnr_sum, cnr_detector          the CNR by both definitions, power ratios
  closed_form                    of --estimator ratio: mean, median, std and s68, as far as theory has them

Statistics are of the estimates as they are. Not all laws have all moments: ratio has no std with one look, tls and
noise_subtraction have neither mean nor std; there, mean and std say little, median and s68 tell.

examples:
  sal-height montecarlo pair --theta 0.25 --cnr-db 5 --looks 4
  sal-height montecarlo pair --theta 0.25 --cnr-db 5 --looks 4 --estimator tls --json
  sal-height montecarlo pair --pattern jinc --pitch 0.6 --size 0.6x1.2 --target steady --looks 1
""",
)

ARRAY = STATISTICS.format(
    clipped="stopped at an end of the search, or have no pair",
    more="""  domain                         ends of the search; at low CNR they decide the std
  cnr_detector                   power ratio

examples:
  sal-height montecarlo array --theta 1.75 --cnr-db 4.77 --looks 4
  sal-height montecarlo array --theta 3.5 --cnr-db 20 --looks 16 --objective seed --json
  sal-height montecarlo array --theta 0.1 --cnr-db 10 --looks 16 --estimator tls
  sal-height montecarlo array --pattern beams.csv --pitch 0.5 --theta 0.1
""",
)
