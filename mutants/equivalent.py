"""Mutants that no test can distinguish from the original, file by file, with the reason.

A change is written as `python -m mutants` prints it, with the C function before it where others have the same line. A run counts
these apart, and says so when a test kills one of them.
"""

_ROUNDED = "computed real numbers: where they are equal to the last bit either decision is as good"

_ASKED = "a flag that is asked for being zero"
_ROOM = "room for more than is ever used"
_TINY = "bytes of one are 1e-303"
_SCALE = "a scale that the sum takes out again"
_NO_COLUMN = "the row has no column in the upper triangle"
_SWEEPS = "of matrices of about the size of one, Jacobi's rotations end at the same axes, a sweep sooner or later"
_ODDS = (
    "odds -= (DIRECTIONS - UPRIGHT - 1) * prior_log_odds(m);",
    "odds += (DIRECTIONS - UPRIGHT - 1) * prior_log_odds(m);",
    "odds -= (DIRECTIONS + UPRIGHT - 1) * prior_log_odds(m);",
    "odds -= (DIRECTIONS - UPRIGHT + 1) * prior_log_odds(m);",
    "odds -= (DIRECTIONS - UPRIGHT - 2) * prior_log_odds(m);",
)

_COPIED = "an estimate takes a read-only copy of numbers that can be written"
_NO_TIME = "nothing moves in no time"
_HEAVE_ALONE = "the fifth is the deck's roll, which has nothing in common with the heave"
_HELD = "if (b->t_imu >= 0 && b->t < held_until && held_until < t) {"
_DRIVEN = tuple(f"for (int {i} = {j} / 2 * 2; {i} < STATES; {i}++) {{" for i, j in ("ji", "li", "lj"))
_SPANS = "const int64_t i = forecast ? span(course, age) : 0, k = forecast ? span(course, until) : 0;"
_ROTATED = "const double t = (theta < 0.0 ? -1.0 : 1.0) / (fabs(theta) + hypot(theta, 1.0)), c = 1.0 / hypot(t, 1.0), s = t * c;"
_LINEAR = "the line ends there and the other begins"
EQUIVALENT: dict[str, dict[str, str]] = {
    "companion/guidance/mission/descend.py": {
        "error_m < math.sqrt(INSIDE) * radius_m(height_m, options)"
        "  ->  error_m <= math.sqrt(INSIDE) * radius_m(height_m, options)": _ROUNDED,
        "error_m > math.sqrt(OUT) * radius_m(height_m, options)"
        "  ->  error_m >= math.sqrt(OUT) * radius_m(height_m, options)": _ROUNDED,
    },
    "companion/guidance/law/records.py": {
        "0  ->  1": "one horizon is no course, as none is",
        "0.0  ->  1.0": "a flag beside it says that there is none, and the core reads none",
    },
    "companion/guidance/mission/search.py": {
        "0.0 < along < way_m  ->  0.0 <= along < way_m": _ROUNDED,
        "abs(turn) <= _ROUND_RAD  ->  abs(turn) < _ROUND_RAD": _ROUNDED,
    },
    "companion/guidance/mission/vessel_track.py": {
        "report.v_vessel_ned is not None and report.cov_v_ned is not None"
        "  ->  report.v_vessel_ned is not None or report.cov_v_ned is not None": "no report has one of them alone",
        "math.hypot(*v_vessel) >= _COURSE_FROM_M_S  ->  math.hypot(*v_vessel) > _COURSE_FROM_M_S": _ROUNDED,
        "math.hypot(*step) > may_m  ->  math.hypot(*step) >= may_m": _ROUNDED,
    },
    "companion/guidance/mission/clearance.py": {
        "span_s <= 0.0  ->  span_s < 0.0": "over no time nothing is summed",
        "before * after < 0.0  ->  before * after <= 0.0": "where one of them is zero the triangle is the whole area",
        "True  ->  False": "a forecast has as many sigmas as rates",
    },
    "companion/guidance/law/response_fit.py": {
        "1e-12  ->  2e-12": "it keeps zero out of a denominator, and a report is never known to a millionth",
    },
    "companion/guidance/law/gains.py": {"1e-09  ->  2e-09": "what floating point adds is 1e-15"},
    "companion/guidance/law/response_watch.py": {
        "self.longer_s > 0.0  ->  self.longer_s >= 0.0": "an identified response is off by more than 40 ms",
    },
    "companion/guidance/law/response_course.py": {
        "np.isfinite(u).all  ->  np.isfinite(u).any": "a step is unknown on all axes",
    },
    "companion/guidance/law/margins.py": {
        "40  ->  41": "the sum has converged",
        "angle[:-1] * angle[1:] < 0.0  ->  angle[:-1] * angle[1:] <= 0.0": _ROUNDED,
        "np.abs(angle[:-1]) > 2.0  ->  np.abs(angle[:-1]) >= 2.0": _ROUNDED,
    },
    "estimator/pipeline.py": {
        "None if self._newest is None else self.at(self._newest)  ->  self.at(self._newest)": (
            "before the first event there is no pad at any instant"
        ),
        "True  ->  False": "each path has one result of each event",
    },
    "estimator/ekf/filter.py": {
        "self._words.setflags(write=False)  ->  pass": _COPIED,
        "False  ->  True": _COPIED,
        "var_max <= o.consistent_sigma_m ** 2  ->  var_max < o.consistent_sigma_m ** 2": _ROUNDED,
    },
    "estimator/integrity/sensors.py": {
        "t < repeat.since  ->  t <= repeat.since": "what begins anew at its own instant with its own value is the same",
        "off_s > step  ->  off_s >= step": "where they are equal either is the step",
    },
    "estimator/integrity/tracks.py": {"2.0 * _ALIVE_S  ->  2.0 / _ALIVE_S": "it is one second"},
    "estimator/integrity/crosschecks.py": {
        "distance_m < 1e-06  ->  distance_m <= 1e-06": _ROUNDED,
        "True  ->  False": "every bearing has four parts",
        "_spread(np.array(seen)) < o.view_still_ratio * turned"
        "  ->  _spread(np.array(seen)) <= o.view_still_ratio * turned": _ROUNDED,
        "turned > o.view_turned_min_rad  ->  turned >= o.view_turned_min_rad": _ROUNDED,
    },
    "estimator/core/filter/answer.c": {
        "for (int k = 0; k < PER_DIRECTION; k++) {  ->  for (int k = 0; k <= PER_DIRECTION; k++) {": (
            "the pad's acceleration along down does not depend on the deck's roll, which lies behind"
        ),
        "for (int i = 0; i < DL_N; i++) {  ->  for (int i = 1; i < DL_N; i++) {": "no figure is of the attitude's error",
        "double J[6 * DL_N] = {0.0}, tilt[4 * DL_N] = {0.0};  ->  double J[6 * DL_N] = {0.0}, tilt[5 * DL_N] = {0.0};": _ROOM,
        "covariance c = {before->P, {places[0], places[1]}};  ->  covariance c = {before->P, {places[1], places[1]}};": (
            "the covariance is propagated once at most"
        ),
        "memset(out, 0, sizeof *out);  ->  memset(out, 1, sizeof *out);": _TINY,
    },
    "estimator/core/vision/sighting_level.c": {
        "static const double LEAST_FLAT = 1e-9;  ->  static const double LEAST_FLAT = 2e-09;": (
            "it keeps zero out of a denominator"
        ),
    },
    "estimator/core/base/rotation.c": {
        "if (s < 1e-6 && cosine <= 0.0) {  ->  if (s <= 1e-6 && cosine <= 0.0) {": _ROUNDED,
        "if (s >= 1e-6) {  ->  if (s > 1e-6) {": _ROUNDED,
        "if (t2 >= 1e-8) {  ->  if (t2 > 1e-8) {": _ROUNDED,
        "if (t2 >= 1e-6) {  ->  if (t2 > 1e-6) {": _ROUNDED,
    },
    "estimator/core/filter/jacobian.c": {
        "memset(JF, 0, (size_t)m * DL_N * sizeof *JF);  ->  memset(JF, 1, (size_t)m * DL_N * sizeof *JF);": _TINY,
        "rows_times: for (int k = 0; k < DL_N; k++) {  ->  for (int k = 1; k < DL_N; k++) {": (
            "a turn about the nose changes neither heading nor what is written in level"
        ),
        "AT(JF, i, j) += factor * AT(F, k, j);  ->  AT(JF, i, j) -= factor * AT(F, k, j);": (
            "the covariance takes each row twice, so that its sign goes out"
        ),
        "columns_of: for (int i = 0; i < m; i++) {  ->  for (int i = 0; i <= m; i++) {": (
            "a column too many in which the matrix is zero adds nothing"
        ),
        "add_spread: for (int i = 0; i < m; i++) {  ->  for (int i = 0; i <= m; i++) {": (
            "what is made of a row behind the last is not written"
        ),
    },
    "estimator/core/filter/forecast.c": {
        "double J[3 * DL_N] = {0.0}, by[2][2], reach[2][2], d[3];"
        "  ->  double J[3 * DL_N] = {0.0}, by[2][2], reach[2][2], d[4];": _ROOM,
        "covariance c = {before->P, {places[0], places[1]}};  ->  covariance c = {before->P, {places[0], places[2]}};": (
            "the covariance is propagated once, so that one place would do"
        ),
        "return 1;  ->  return 2;": _ASKED,
    },
    "estimator/core/filter/run.c": {
        "return !b->heading_is_given || var > DIVERGED_VAR;  ->  return !b->heading_is_given || var >= DIVERGED_VAR;": _ROUNDED,
        "return 1;  ->  return 2;": _ASKED,
        "covariance c = {before->P, {places[0], places[1]}};  ->  covariance c = {before->P, {places[1], places[1]}};": (
            "one place would do: the correction after a propagation is never refused, and reads each row before it writes it"
        ),
    },
    "estimator/core/law/law.c": {
        "const double shrink = size > reach ? reach / size : 1.0;"
        "  ->  const double shrink = size >= reach ? reach / size : 1.0;": _LINEAR,
        "const double cut = size > most ? most / size : 1.0;  ->  const double cut = size >= most ? most / size : 1.0;": _LINEAR,
        "if (!o->keeps_in_view || d[2] < VIEW_FROM_M) {  ->  if (!o->keeps_in_view || d[2] <= VIEW_FROM_M) {": _ROUNDED,
        "dl_axis_measured z[2];  ->  dl_axis_measured z[3];": _ROOM,
    },
    "estimator/core/law/axis.c": {
        "return value < -most ? -most : value > most ? most : value;"
        "  ->  return value < -most ? -most : value >= most ? most : value;": _LINEAR,
    },
    "estimator/core/law/deck.c": {
        f"{_SPANS}  ->  {_SPANS.replace(was, becomes)}": "without a forecast neither is read"
        for was, becomes in (("age) : 0", "age) : 1"), ("until) : 0", "until) : 1"))
    },
    "estimator/core/filter/bank_ahead.c": {
        f"sum += weight[o] * (of[o] - mean) * (of[o] - mean);  ->  sum += weight[o] * {product};": (
            "the same sum: the weights' mean of the first factor is zero"
        )
        for product in ("(of[o] + mean) * (of[o] - mean)", "(of[o] - mean) * (of[o] + mean)")
    }
    | {
        "memset(after, 0, STATES * sizeof after[0]);  ->  memset(after, 1, STATES * sizeof after[0]);": _TINY,
        "memset(of, 0, OSCILLATORS * sizeof *of);  ->  memset(of, 1, OSCILLATORS * sizeof *of);": _TINY,
        "static const double KNOWN_VAR = 1e-18;  ->  static const double KNOWN_VAR = 2e-18;": (
            "a rate is known to its last bit or with a variance far above either"
        ),
        **{
            f"{loop}  ->  {loop.replace(' / 2 * 2', changed)}": "what it adds are the transition's zeros"
            for loop in _DRIVEN
            for changed in (" / 3 * 2", " / 2 / 2")
        },
    },
    "estimator/core/filter/bank.c": {
        "return g > 0 && m->w[g] == m->w[g - 1] && m->zeta[g] == m->zeta[g - 1];"
        "  ->  return g > 1 && m->w[g] == m->w[g - 1] && m->zeta[g] == m->zeta[g - 1];": "the first two oscillators differ",
        "double A[4][4] = {{0.0}}, q[4][4] = {{0.0}};  ->  double A[4][4] = {{0.0}}, q[4][4] = {{1.0}};": (
            "the first oscillator fills it"
        ),
        "carry_covariances: for (int i = 0; i < STATES; i++) {  ->  for (int i = 0; i <= STATES; i++) {": _NO_COLUMN,
        "add_noises: for (int i = 0; i < 4; i++) {  ->  for (int i = 0; i <= 4; i++) {": _NO_COLUMN,
        "dl_bank_begin: for (int i = 0; i < 4; i++) {  ->  for (int i = 0; i <= 4; i++) {": _NO_COLUMN,
    },
    "estimator/core/filter/bank_weights.c": {
        **{
            f"{_ODDS[0]}  ->  {changed}": "the shipped prior of a deck at rest is one half, so it has no odds"
            for changed in _ODDS[1:]
        },
        "const double top = largest(MEMBERS - 1, weight + 1);  ->  const double top = largest(MEMBERS - 2, weight + 1);": _SCALE,
        "weight[g] = exp(weight[g] - top);  ->  weight[g] = exp(weight[g] + top);": _SCALE,
    },
    "estimator/core/filter/correction.c": {
        "for (int i = 0; i < DL_N; i++) {  ->  for (int i = 1; i < DL_N; i++) {": "the attitude's error is zero afterwards",
    },
    "estimator/core/filter/gathering.c": {
        "return seconds(a->since, t) > 2.0 * o->aiding_period_s;  ->  return seconds(a->since, t) >= 2.0 * o->aiding_period_s;": (
            _ROUNDED
        ),
        "if (m > 0 && kalman_correct(DL_N, c->P, &(measured){m, innov, H, R}, dx, place, S, &nis)) {"
        "  ->  if (m >= 0 && kalman_correct(DL_N, c->P, &(measured){m, innov, H, R}, dx, place, S, &nis)) {": (
            "a correction by nothing is none"
        ),
        "double *P = changeable(c), g[DL_N] = {0.0};  ->  double *P = changeable(c), g[DL_N] = {1.0};": "always written first",
        "memset(a->innov, 0, sizeof a->innov);  ->  memset(a->innov, 1, sizeof a->innov);": _TINY,
        "memset(a->R, 0, sizeof a->R);  ->  memset(a->R, 1, sizeof a->R);": _TINY,
        "tell(out, nis > nis_max ? DL_GATED : DL_FUSED, m, (int)begun->axes, innov, S);"
        "  ->  tell(out, nis >= nis_max ? DL_GATED : DL_FUSED, m, (int)begun->axes, innov, S);": _ROUNDED,
        "if (nis > nis_max) {  ->  if (nis >= nis_max) {": _ROUNDED,
    },
    "estimator/core/filter/aiding.c": {
        "if (away + 2.0 * spread > o->deck_radius_m || !distance(b->R, x, &r, H)) {"
        "  ->  if (away + 2.0 * spread >= o->deck_radius_m || !distance(b->R, x, &r, H)) {": _ROUNDED,
        "if (cosine < 0.3) {  ->  if (cosine <= 0.3) {": _ROUNDED,
        "b->is_levelled = b->heading_is_given = 1;  ->  b->is_levelled = b->heading_is_given = 2;": _ASKED,
    },
    "estimator/core/filter/sighting.c": {
        "noise_of: for (int i = 0; i < 9; i++) {  ->  for (int i = 0; i <= 9; i++) {": "the tenth is zero, or written afterwards",
    },
    "estimator/core/filter/propagate.c": {
        "if (dt <= 0.0) {  ->  if (dt < 0.0) {": _NO_TIME,
        "if (T <= 0.0) {  ->  if (T < 0.0) {": _NO_TIME,
        **{
            f"{_HELD}  ->  {_HELD.replace(*changed)}": _NO_TIME
            for changed in (("t < held", "t <= held"), ("until < t", "until <= t"))
        },
        "move_vessel: for (int j = 0; j < 4; j++) {  ->  for (int j = 0; j <= 4; j++) {": _HEAVE_ALONE,
        "move_vessel: for (int j = 0; j < 4; j++) {  ->  for (int j = 0; j < 5; j++) {": _HEAVE_ALONE,
        "memset(F, 0, DL_N * DL_N * sizeof *F);  ->  memset(F, 1, DL_N * DL_N * sizeof *F);": _TINY,
        "memset(Q, 0, DL_N * DL_N * sizeof *Q);  ->  memset(Q, 1, DL_N * DL_N * sizeof *Q);": _TINY,
        **{
            f"memset(b->{name}, 0, sizeof b->{name});  ->  memset(b->{name}, 1, sizeof b->{name});": _TINY
            for name in ("dv", "dp", "turned")
        },
        "propagated_belief: for (int i = 0; i < DL_N; i++) {  ->  for (int i = 1; i < DL_N; i++) {": (
            "the attitude's block is written whole"
        ),
        "peek: for (int k = 0; k < 5; k++) {  ->  for (int k = 1; k < 5; k++) {": (
            "no sensor whose model looks at this state measures the displacement north"
        ),
    },
    "estimator/core/base/kalman.c": {
        "if (!(pivot > 0.0) || !isfinite(pivot)) {  ->  if (!(pivot >= 0.0) || !isfinite(pivot)) {": (
            "a pivot of zero makes a NIS that is not finite, which is refused as well"
        ),
        "solve_rows: for (int i = 0; i < m; i++) {  ->  for (int i = 1; i < m; i++) {": "the first pivot is one but for rounding",
        "size += dx[k] * dx[k];  ->  size -= dx[k] * dx[k];": "asked for being finite alone",
        "memset(FP[i], 0, sizeof FP[i]);  ->  memset(FP[i], 1, sizeof FP[i]);": _TINY,
    },
    "estimator/core/filter/skill.c": {
        "for (int i = 1; i < known->issued_n; i++) {  ->  for (int i = 1; i <= known->issued_n; i++) {": (
            "what lies behind the newest forecast is older, so that no instant is between them"
        ),
        "while (after < SKILL_HORIZONS - 1 && SKILL_HORIZONS_S[after] <= horizon_s) {"
        "  ->  while (after < SKILL_HORIZONS - 1 && SKILL_HORIZONS_S[after] < horizon_s) {": "the interpolation is continuous",
    },
    "estimator/core/filter/vessel.c": {
        "enum { ROWS = 4, V_COV = 3, HEADING = 12, HEADING_SIGMA = 13, HAS_VELOCITY = 14, HAS_HEADING = 15 };"
        "  ->  enum { ROWS = 5, V_COV = 3, HEADING = 12, HEADING_SIGMA = 13, HAS_VELOCITY = 14, HAS_HEADING = 15 };": _ROOM,
        "double innov[ROWS], H[ROWS * DL_N] = {0.0}, R[ROWS * ROWS] = {0.0}, S[ROWS * ROWS], dx[DL_N], nis;"
        "  ->  double innov[ROWS], H[ROWS * DL_N] = {0.0}, R[ROWS * ROWS] = {1.0}, S[ROWS * ROWS], dx[DL_N], nis;": (
            "the first of them is always written"
        ),
        "tell(out, nis > out->nis_max ? DL_GATED : DL_FUSED, m, axes, innov, S);"
        "  ->  tell(out, nis >= out->nis_max ? DL_GATED : DL_FUSED, m, axes, innov, S);": _ROUNDED,
    },
    "estimator/core/filter/gate.c": {
        "if (b->rejected_n == 0 || t < b->rejected_last || length(step) > limit || dt > PAUSE_S) {"
        "  ->  if (b->rejected_n == 0 || t < b->rejected_last || length(step) >= limit || dt > PAUSE_S) {": _ROUNDED,
    },
    "estimator/core/filter/deck_jolt.c": {
        "if (fmax(ratio[0], fmax(ratio[1], ratio[2])) > RATIO_COUNTED) {"
        "  ->  if (fmax(ratio[0], fmax(ratio[1], ratio[2])) >= RATIO_COUNTED) {": _ROUNDED,
        "while (at > 0 && ordered[at - 1] > value) {  ->  while (at > 0 && ordered[at - 1] < value) {": (
            "the values sorted the other way have the same median"
        ),
        "while (at > 0 && ordered[at - 1] > value) {  ->  while (at > 0 && ordered[at - 1] >= value) {": (
            "equal values may change places"
        ),
        "if (missing[axis] <= 0.0) {  ->  if (missing[axis] < 0.0) {": "a variance of zero adds nothing",
    },
    "estimator/core/base/symmetric.c": {
        "enum { SWEEPS_MAX = 12 };  ->  enum { SWEEPS_MAX = 13 };": _ROOM,
        **{
            f"{_ROTATED}  ->  {_ROTATED.replace(before, after)}": _SWEEPS
            for before, after in (
                ("theta < 0.0", "theta <= 0.0"),
                ("theta < 0.0", "theta < 1.0"),
                ("? -1.0 : 1.0", "? -2.0 : 1.0"),
                ("? -1.0 : 1.0", "? -1.0 : 2.0"),
                ("hypot(theta, 1.0)", "hypot(theta, 2.0)"),
            )
        },
        "for (int sweep = 0; sweep < SWEEPS_MAX; sweep++) {  ->  for (int sweep = 1; sweep < SWEEPS_MAX; sweep++) {": _ROOM,
        "for (int sweep = 0; sweep < SWEEPS_MAX; sweep++) {  ->  for (int sweep = 0; sweep <= SWEEPS_MAX; sweep++) {": _ROOM,
        "for (int p = 0; p < m; p++) {  ->  for (int p = 0; p <= m; p++) {": "no column lies behind the last one's row",
        "double off = 0.0, size = 0.0;  ->  double off = 1.0, size = 0.0;": _SWEEPS,
        "double off = 0.0, size = 0.0;  ->  double off = 0.0, size = 1.0;": _SWEEPS,
        "size += A[i][i] * A[i][i];  ->  size -= A[i][i] * A[i][i];": _SWEEPS,
        "size += A[i][i] * A[i][i];  ->  size += A[i][i] / A[i][i];": _SWEEPS,
        "off += A[i][j] * A[i][j];  ->  off += A[i][j] / A[i][j];": _SWEEPS,
        "if (off <= 1e-32 * size) {  ->  if (off < 1e-32 * size) {": _SWEEPS,
        "if (off <= 1e-32 * size) {  ->  if (off <= 2e-32 * size) {": _SWEEPS,
        "if (off <= 1e-32 * size) {  ->  if (off <= 0.0 * size) {": _SWEEPS,
        "if (off <= 1e-32 * size) {  ->  if (off <= 1e-32 / size) {": _SWEEPS,
    },
    "estimator/core/filter/vision_update.c": {
        "const int lost = sqrt(fmax(var / 3.0, 0.0)) > LOST_SIGMA_M;"
        "  ->  const int lost = sqrt(fmax(var / 3.0, 0.0)) >= LOST_SIGMA_M;": _ROUNDED,
        "if (row->ok && (turned_round || (row->m > 3 && row->nis <= o->nis_max[row->m - 1]))) {"
        "  ->  if (row->ok && (turned_round || (row->m > 3 && row->nis < o->nis_max[row->m - 1]))) {": _ROUNDED,
        "if (row->nis > o->nis_max[dof - 1]) {  ->  if (row->nis >= o->nis_max[dof - 1]) {": _ROUNDED,
        "compare(o, b, c->P, s, 1, other);  ->  compare(o, b, c->P, s, 2, other);": _ASKED,
    },
}
