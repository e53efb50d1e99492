/* A car that follows another one, as a co-simulation FMU (FMI 2.0): the leader brakes, and the car brakes late. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { GAP, SPEED, LEADER_SPEED, LEADER_BRAKE, DELAY, DISTANCE, CLOSING_SPEED, REALS };
enum { DRY, WET };
typedef struct {
    double v[REALS], time, seen;
    int road;
} Model;

static void restart(Model *m) {
    static const double start[REALS] = {[GAP] = 30, [SPEED] = 25, [LEADER_SPEED] = 25, [LEADER_BRAKE] = 4, [DELAY] = 1};
    memset(m, 0, sizeof *m);
    memcpy(m->v, start, sizeof start);
    m->seen = -1;
}

static void outputs(Model *m) {
    m->v[CLOSING_SPEED] = m->v[SPEED] - m->v[LEADER_SPEED];
}

static void step(Model *m, double h) {
    const double grip = m->road == WET ? 4.5 : 8.0;
    const double leader_brake = m->time < 1.0 ? 0.0 : fmin(m->v[LEADER_BRAKE], grip);
    /* It notices that the leader comes closer by 1 m/s, and brakes after its delay. */
    if (m->seen < 0 && m->v[SPEED] - m->v[LEADER_SPEED] > 1.0) m->seen = m->time;
    const double brake = m->seen >= 0 && m->time >= m->seen + m->v[DELAY] ? grip : 0.0;
    const double speed = fmax(0.0, m->v[SPEED] - brake * h);
    const double leader_speed = fmax(0.0, m->v[LEADER_SPEED] - leader_brake * h);
    m->v[DISTANCE] += 0.5 * (m->v[SPEED] + speed) * h;
    m->v[GAP] += 0.5 * (m->v[LEADER_SPEED] + leader_speed - m->v[SPEED] - speed) * h;
    m->v[SPEED] = speed;
    m->v[LEADER_SPEED] = leader_speed;
    m->time += h;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void *fmi2Instantiate(const char *n, int t, const char *g, const char *r, const void *f, int v, int l) {
    Model *m = malloc(sizeof *m);
    if (m) restart(m);
    return m;
}
void fmi2FreeInstance(void *m) { free(m); }
int fmi2Reset(void *m) { restart(m); return 0; }
int fmi2SetupExperiment(void *m, int d, double t, double s, int e, double p) { return 0; }
int fmi2EnterInitializationMode(void *m) { return 0; }
int fmi2ExitInitializationMode(void *m) { outputs(m); return 0; }
int fmi2Terminate(void *m) { return 0; }
int fmi2SetReal(void *m, const unsigned *r, size_t n, const double *x) {
    for (size_t i = 0; i < n; i++) ((Model *)m)->v[r[i]] = x[i];
    return 0;
}
int fmi2GetReal(void *m, const unsigned *r, size_t n, double *x) {
    for (size_t i = 0; i < n; i++) x[i] = ((Model *)m)->v[r[i]];
    return 0;
}
int fmi2SetInteger(void *m, const unsigned *r, size_t n, const int *x) {
    for (size_t i = 0; i < n; i++) ((Model *)m)->road = x[i];
    return 0;
}
int fmi2GetInteger(void *m, const unsigned *r, size_t n, int *x) {
    for (size_t i = 0; i < n; i++) x[i] = ((Model *)m)->road;
    return 0;
}
int fmi2DoStep(void *m, double t, double h, int keep) {
    step(m, h);
    outputs(m);
    return 0;
}
#define NOT_USED(name) int name(void) { return 3; }
NOT_USED(fmi2SetDebugLogging) NOT_USED(fmi2GetBoolean) NOT_USED(fmi2GetString) NOT_USED(fmi2SetBoolean)
NOT_USED(fmi2SetString) NOT_USED(fmi2GetFMUstate) NOT_USED(fmi2SetFMUstate) NOT_USED(fmi2FreeFMUstate)
NOT_USED(fmi2SerializedFMUstateSize) NOT_USED(fmi2SerializeFMUstate) NOT_USED(fmi2DeSerializeFMUstate)
NOT_USED(fmi2GetDirectionalDerivative) NOT_USED(fmi2SetRealInputDerivatives)
NOT_USED(fmi2GetRealOutputDerivatives) NOT_USED(fmi2CancelStep) NOT_USED(fmi2GetStatus) NOT_USED(fmi2GetRealStatus)
NOT_USED(fmi2GetIntegerStatus) NOT_USED(fmi2GetBooleanStatus) NOT_USED(fmi2GetStringStatus)
