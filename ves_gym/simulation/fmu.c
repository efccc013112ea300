/* Co-simulation by FMI 3.0 of one system, whose equations are in equations.c.

   Variables are all Float64 and lie in one row, their value reference the place: time, inputs,
   parameters (gains, start, and the step that communication steps are multiples of), outputs.
   model.h has how many there are. In the laboratory (EMULATED) that step is a control period.
   Written for this project after the standard's text; no header of others is needed. */

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

#ifdef _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef enum { INSTANTIATED, INITIALIZATION, STEP, TERMINATED } Phase;
typedef void (*Log)(void *environment, int status, const char *category, const char *message);
typedef int (*Graph)(const double **arg, double **res, long long *iw, double *w, int mem);
typedef int (*Sizes)(long long *arg, long long *res, long long *iw, long long *w);

int start(const double **, double **, long long *, double *, int);
int start_work(long long *, long long *, long long *, long long *);
int slope(const double **, double **, long long *, double *, int);
int slope_work(long long *, long long *, long long *, long long *);
int observe(const double **, double **, long long *, double *, int);
int observe_work(long long *, long long *, long long *, long long *);
#if EMULATED
int before(const double **, double **, long long *, double *, int);
int before_work(long long *, long long *, long long *, long long *);
int felt(const double **, double **, long long *, double *, int);
int felt_work(long long *, long long *, long long *, long long *);
int after(const double **, double **, long long *, double *, int);
int after_work(long long *, long long *, long long *, long long *);
#endif

/* places of the first of each kind in the row of values; GAINS, START and STEP_AT are set */
enum { TIME = 0, INPUTS = 1, GAINS = INPUTS + NU, START = GAINS + NG, STEP_AT = START + NS,
       OUTPUTS = STEP_AT + 1, VALUES = OUTPUTS + NY };

typedef struct { /* all that get and set of a state copy */
  double value[VALUES], x[NX];
  Phase phase;
  bool fresh; /* outputs belong to x and inputs */
} State;

typedef struct {
  State s;
  void *environment;
  Log log;
  const double *arg[16];
  double *res[16], *w;
  long long *iw;
} Instance;

static const double DEFAULTS[VALUES] = DEFAULT_VALUES;

static Status fail(Instance *m, const char *text) {
  if (m->log) m->log(m->environment, ERROR, "logStatusError", text);
  return ERROR;
}

/* ------------------------------------------------------------------------ the model */

static void call(Instance *m, Graph graph, const double *a, const double *b, double *out) {
  m->arg[0] = a, m->arg[1] = b, m->arg[2] = m->s.value + GAINS, m->res[0] = out;
  graph(m->arg, m->res, m->iw, m->w, 0);
}

static void begin(Instance *m) { call(m, start, m->s.value + START, NULL, m->s.x); }

static void outputs(Instance *m) {
  if (m->s.phase < STEP) begin(m); /* start values may still change */
  call(m, observe, m->s.x, m->s.value + INPUTS, m->s.value + OUTPUTS);
  m->s.fresh = true;
}

/* A physics step by the classic rule of Runge and Kutta, inputs linear from one to the other. */
static void advance(Instance *m, double h, const double *from, const double *to) {
  double k[4][NE], at[NE], middle[NI], *x = m->s.x;
  const double *u[4] = {from, middle, middle, to}, share[4] = {0.0, 0.5, 0.5, 1.0};
  for (int i = 0; i < NI; i++) middle[i] = from[i] + 0.5 * (to[i] - from[i]);
  for (int j = 0; j < 4; j++) {
    for (int i = 0; i < NE; i++) at[i] = j ? x[i] + share[j] * h * k[j - 1][i] : x[i];
    call(m, slope, at, u[j], k[j]);
  }
  for (int i = 0; i < NE; i++)
    x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
}

#if EMULATED
/* A control period: readings to the platform's path, arm and platform on it, new readings. */
static void go_on(Instance *m, double unit) {
  double next[NX], path[6 * NODES], wrench[6 * NODES], u[NODES][NI], *x = m->s.x;
  m->res[1] = path;
  call(m, before, x, NULL, next);
  memcpy(x, next, sizeof next);
  for (int j = 0; j < NODES; j++) {
    memcpy(u[j], path + 6 * j, 6 * sizeof *path);
    memcpy(u[j] + 6, m->s.value + INPUTS, NU * sizeof *path);
  }
  for (int j = 0; j < NODES; j++) {
    call(m, felt, x, u[j], wrench + 6 * j);
    if (j + 1 < NODES) advance(m, unit / (NODES - 1), u[j], u[j + 1]);
  }
  call(m, after, x, wrench, next);
  memcpy(x, next, sizeof next);
}
#else
static void go_on(Instance *m, double unit) {
  advance(m, unit, m->s.value + INPUTS, m->s.value + INPUTS);
}
#endif

static const char *fault(const double *x) {
  for (int i = 0; i < NE; i++)
    if (!(fabs(x[i]) < MEANINGLESS)) return "the simulation diverged";
  if (FREE && cos(x[4]) < STEEPEST) return "phi_y reached 89 deg: Z-Y-X angles end at 90";
  return NULL;
}

/* ------------------------------------------------------------------------ life */

static bool reserve(Instance *m) {
  const Sizes sizes[] = {start_work, slope_work, observe_work,
#if EMULATED
                         before_work, felt_work, after_work,
#endif
  };
  long long most[4] = {0};
  for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
    long long n[4] = {0};
    sizes[i](n, n + 1, n + 2, n + 3);
    for (int j = 0; j < 4; j++)
      if (n[j] > most[j]) most[j] = n[j];
  }
  m->iw = calloc(most[2] + 1, sizeof *m->iw), m->w = calloc(most[3] + 1, sizeof *m->w);
  return most[0] <= 16 && most[1] <= 16 && m->iw && m->w;
}

API void fmi3FreeInstance(Instance *m) {
  if (m) free(m->iw), free(m->w), free(m);
}

static void restore(Instance *m) {
  memset(&m->s, 0, sizeof m->s);
  memcpy(m->s.value, DEFAULTS, sizeof DEFAULTS);
}

API Instance *fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *resources, bool visible, bool logging,
    bool events, bool early, const unsigned *required, size_t n, void *environment, Log log,
    void *update) {
  (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early;
  (void)required, (void)n, (void)update;
  Instance *m = calloc(1, sizeof *m);
  if (!m) return NULL;
  m->environment = environment, m->log = log;
  if (!token || strcmp(token, TOKEN)) {
    fail(m, "the instantiation token is another model's");
  } else if (reserve(m)) {
    restore(m);
    return m;
  }
  fmi3FreeInstance(m);
  return NULL;
}

API void *fmi3InstantiateModelExchange(void) { return NULL; }
API void *fmi3InstantiateScheduledExecution(void) { return NULL; }
API const char *fmi3GetVersion(void) { return "3.0"; }
API Status fmi3SetDebugLogging(void) { return OK; }

API Status fmi3EnterInitializationMode(
    Instance *m, bool tolerant, double tolerance, double begins, bool ends, double end) {
  (void)tolerant, (void)tolerance, (void)ends, (void)end;
  if (m->s.phase != INSTANTIATED) return fail(m, "initialization comes first, and once");
  m->s.value[TIME] = begins, m->s.phase = INITIALIZATION, m->s.fresh = false;
  return OK;
}

API Status fmi3ExitInitializationMode(Instance *m) {
  double h = m->s.value[STEP_AT];
  char text[128];
  if (m->s.phase != INITIALIZATION) return fail(m, "there is no initialization to end");
  if (!(h > 0 && h <= LONGEST * (1 + 1e-9)) || (EMULATED && h != LONGEST)) {
    snprintf(text, sizeof text, "physics_dt must be > 0 and <= %g s, got %g", LONGEST, h);
    return fail(m, text);
  }
  begin(m);
  m->s.phase = STEP, m->s.fresh = false;
  return OK;
}

API Status fmi3Terminate(Instance *m) { return m->s.phase = TERMINATED, OK; }
API Status fmi3Reset(Instance *m) { return restore(m), OK; }

API Status fmi3DoStep(
    Instance *m, double at, double length, bool kept, bool *event, bool *terminate,
    bool *early, double *reached) {
  (void)kept;
  double h = m->s.value[STEP_AT], count = floor(length / h + 0.5), first = m->s.value[TIME];
  char text[160];
  *event = *terminate = *early = false, *reached = first;
  if (m->s.phase != STEP) return fail(m, "a step needs an initialized model");
  if (fabs(at - first) > 1e-6 * h + 1e-12 * fabs(at))
    return fail(m, "a step must begin where the last one ended");
  if (count < 1 || fabs(length / h - count) > 1e-6 * count) {
    snprintf(text, sizeof text,
             "a communication step must be a whole number of %s of %g s, got %.9g s",
             EMULATED ? "control periods" : "physics steps", h, length);
    return fail(m, text);
  }
  const char *wrong = NULL;
  m->s.fresh = false;
  for (double i = 0; i < count && !wrong; i++) go_on(m, h), wrong = fault(m->s.x);
  if (wrong) return fail(m, wrong);
  m->s.value[TIME] = *reached = at + length;
  return OK;
}

/* ------------------------------------------------------------------------ values */

API Status fmi3GetFloat64(
    Instance *m, const unsigned refs[], size_t n, double values[], size_t size) {
  for (size_t i = 0; i < n && i < size; i++) {
    if (refs[i] >= VALUES) return fail(m, "no such variable");
    if (refs[i] >= OUTPUTS && !m->s.fresh) outputs(m);
    values[i] = m->s.value[refs[i]];
  }
  return OK;
}

API Status fmi3SetFloat64(
    Instance *m, const unsigned refs[], size_t n, const double values[], size_t size) {
  for (size_t i = 0; i < n && i < size; i++) {
    bool input = refs[i] >= INPUTS && refs[i] < GAINS;
    bool parameter = refs[i] >= GAINS && refs[i] < OUTPUTS;
    if (!input && !(parameter && m->s.phase < STEP))
      return fail(m, "only inputs can be set, and parameters before the first step");
    m->s.value[refs[i]] = values[i];
  }
  m->s.fresh = false;
  return OK;
}

API Status fmi3GetFMUState(Instance *m, State **state) {
  if (!*state) *state = malloc(sizeof **state);
  if (!*state) return fail(m, "no memory for a state");
  return **state = m->s, OK;
}

API Status fmi3SetFMUState(Instance *m, State *state) { return m->s = *state, OK; }
API Status fmi3FreeFMUState(Instance *m, State **state) {
  (void)m;
  return free(*state), *state = NULL, OK;
}
API Status fmi3SerializedFMUStateSize(Instance *m, State *state, size_t *size) {
  (void)m, (void)state;
  return *size = sizeof *state, OK;
}
API Status fmi3SerializeFMUState(Instance *m, State *state, unsigned char bytes[], size_t n) {
  if (n < sizeof *state) return fail(m, "too little room for a state");
  return memcpy(bytes, state, sizeof *state), OK;
}
API Status fmi3DeserializeFMUState(
    Instance *m, const unsigned char bytes[], size_t n, State **state) {
  if (n != sizeof **state) return fail(m, "these bytes are no state of this model");
  if (!*state) *state = malloc(sizeof **state);
  if (!*state) return fail(m, "no memory for a state");
  return memcpy(*state, bytes, sizeof **state), OK;
}

/* what a model without events, clocks and other types has not */
#define NOT_HERE(name) API Status name(void) { return ERROR; }
NOT_HERE(fmi3EnterEventMode) NOT_HERE(fmi3EnterStepMode) NOT_HERE(fmi3EnterConfigurationMode)
NOT_HERE(fmi3ExitConfigurationMode) NOT_HERE(fmi3EnterContinuousTimeMode)
NOT_HERE(fmi3GetFloat32) NOT_HERE(fmi3GetInt8) NOT_HERE(fmi3GetUInt8) NOT_HERE(fmi3GetInt16)
NOT_HERE(fmi3GetUInt16) NOT_HERE(fmi3GetInt32) NOT_HERE(fmi3GetUInt32) NOT_HERE(fmi3GetInt64)
NOT_HERE(fmi3GetUInt64) NOT_HERE(fmi3GetBoolean) NOT_HERE(fmi3GetString) NOT_HERE(fmi3GetBinary)
NOT_HERE(fmi3GetClock) NOT_HERE(fmi3SetFloat32) NOT_HERE(fmi3SetInt8) NOT_HERE(fmi3SetUInt8)
NOT_HERE(fmi3SetInt16) NOT_HERE(fmi3SetUInt16) NOT_HERE(fmi3SetInt32) NOT_HERE(fmi3SetUInt32)
NOT_HERE(fmi3SetInt64) NOT_HERE(fmi3SetUInt64) NOT_HERE(fmi3SetBoolean) NOT_HERE(fmi3SetString)
NOT_HERE(fmi3SetBinary) NOT_HERE(fmi3SetClock) NOT_HERE(fmi3GetNumberOfVariableDependencies)
NOT_HERE(fmi3GetVariableDependencies) NOT_HERE(fmi3GetDirectionalDerivative)
NOT_HERE(fmi3GetAdjointDerivative) NOT_HERE(fmi3GetIntervalDecimal)
NOT_HERE(fmi3GetIntervalFraction) NOT_HERE(fmi3GetShiftDecimal) NOT_HERE(fmi3GetShiftFraction)
NOT_HERE(fmi3SetIntervalDecimal) NOT_HERE(fmi3SetIntervalFraction)
NOT_HERE(fmi3SetShiftDecimal) NOT_HERE(fmi3SetShiftFraction) NOT_HERE(fmi3EvaluateDiscreteStates)
NOT_HERE(fmi3UpdateDiscreteStates) NOT_HERE(fmi3CompletedIntegratorStep) NOT_HERE(fmi3SetTime)
NOT_HERE(fmi3SetContinuousStates) NOT_HERE(fmi3GetContinuousStateDerivatives)
NOT_HERE(fmi3GetEventIndicators) NOT_HERE(fmi3GetContinuousStates)
NOT_HERE(fmi3GetNominalsOfContinuousStates) NOT_HERE(fmi3GetNumberOfEventIndicators)
NOT_HERE(fmi3GetNumberOfContinuousStates) NOT_HERE(fmi3GetOutputDerivatives)
NOT_HERE(fmi3ActivateModelPartition)
