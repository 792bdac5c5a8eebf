/* Static deflection of a robot under load, and the joint positions that correct it.

   ABOUT

   q: joint positions, rad (m of a sliding joint). wrench: fx, fy, fz, tx, ty, tz, N and N m, that
   acts on the tool. d: deflection, m. Axes of the robot's base frame. No function checks its
   inputs. Far from the training samples a prediction is a guess. */
#ifndef STIFF_JOINTS
#define STIFF_JOINTS N_JOINTS
#define STIFF_NOT_CONVERGED (-1) /* the steps grow, or there are too many */
#define STIFF_OUT_OF_REACH (-2)  /* no joint positions were found */
#define STIFF_BEYOND_LIMITS (-3) /* a joint would pass its limit */
#define STIFF_REDUNDANT (-4)     /* more than six joints: a pose does not determine them */
#ifdef __cplusplus
extern "C" {
#endif
/* Deflection of the measured point by a wrench at this point. */
void deflection(const double q[], const double wrench[], double d[]);
/* Joint positions with which the TCP, under a wrench at the TCP, is where q has it unloaded; the
   tool does not turn. Returns the number of predictions; or a status, and then the command is q. */
int correct(const double q[], const double wrench[], double command[]);
#ifdef __cplusplus
}
#endif
#endif
